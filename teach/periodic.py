"""Sketches of a motion that repeats, as wiping and stirring do: strokes drawn round and round become single turns.

A turn is a stroke of its own, so that all else in teach takes it for one demonstration of a motion that ends where it
starts. Where a turn starts, no stroke can show but by where it starts itself: strokes of all views start at the same
place of the motion, as those of any motion do.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from teach.curve import extent
from teach.sketch import Sketch, SketchError
from teach.turns import APART, PHASES, TOLERANCE, cuts, turns


def unrolled(sketches: Sequence[Sketch], periodic: bool | None = None) -> tuple[list[Sketch], float]:
    """The sketches with each motion stroke cut into single turns, and how many turns a stroke has (median over
    strokes).

    Turns start where the view's strokes start, on average, so strokes of all views must start at the same place of the
    motion. They are numbered as demonstrations from 0 in each view; each keeps its stroke's clock.

    periodic: None: unless all motion strokes of all views go round and round, the sketches are returned as they are,
    with 0 turns; False: they always are; True: a closed stroke drawn once round is a turn as well, and any other raises
    SketchError. So do strokes of a view that start at different places or go round in opposite directions.
    """
    motions = [stroke for sketch in sketches for stroke in sketch.motions]
    if periodic is False or not motions or min(stroke.length for stroke in motions) <= 0:
        return list(sketches), 0.0  # of those that do not move teach.sketch.check says what is wrong
    if periodic is None and not all(len(cuts(stroke)) for stroke in motions):
        return list(sketches), 0.0
    views = [_unrolled_view(sketch) for sketch in sketches]
    return [sketch for sketch, _ in views], float(np.median(np.concatenate([counts for _, counts in views])))


def _unrolled_view(sketch: Sketch) -> tuple[Sketch, list[int]]:
    """The sketch with its motion strokes cut into turns, and how many each has. Raises SketchError."""
    if not sketch.motions:
        return sketch, []
    start = _common_start(sketch)
    pieces = [turns(stroke, start, once=True) for stroke in sketch.motions]
    for number, found in enumerate(pieces):
        if not found:
            raise SketchError(f"stroke {number} on view {sketch.view!r} does not go round: close it or draw it round "
                              "and round, or fit with periodic=False")
    _require_one_way(sketch.view, pieces)
    single = [replace(turn, demonstration=number) for number, turn in enumerate(chain(*pieces))]
    others = [stroke for stroke in sketch.strokes if stroke.kind != "motion"]
    return replace(sketch, strokes=(*single, *others)), [len(found) for found in pieces]


def _common_start(sketch: Sketch) -> np.ndarray:
    """Mean (2,) [px] of where the view's strokes start. Raises SketchError where that is no one place."""
    starts = np.stack([stroke.points[0] for stroke in sketch.motions])
    start, size = starts.mean(axis=0), np.median([extent(stroke.points) for stroke in sketch.motions])
    away = np.linalg.norm(starts - start, axis=1)
    if away.max() > APART * size:
        raise SketchError(f"the strokes on view {sketch.view!r} start up to {2 * away.max():.0f} px apart: start all "
                          "strokes of a periodic motion at the same place, or fit with periodic=False")
    return start


def _require_one_way(view: str, pieces) -> None:
    """Raise SketchError if a stroke goes round against the first. pieces: the turns of each stroke."""
    phases = np.arange(PHASES) / PHASES
    shapes = [np.mean([turn.at(phases) for turn in found], axis=0) for found in pieces]
    for number, shape in enumerate(shapes):
        same, opposite = (_distance(shapes[0], other) for other in (shape, np.roll(shape[::-1], 1, axis=0)))
        if same > TOLERANCE * extent(shape) and opposite < same:
            raise SketchError(f"stroke {number} on view {view!r} goes round in the opposite direction to stroke 0: "
                              "draw all strokes the same way round")


def _distance(a, b) -> float:
    """RMS distance [px] of corresponding points (N, 2)."""
    return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean()))
