"""Hooks: the short way back that a pen draws as it lands, or as it is lifted, and that is no part of the motion.

Notation
    z(s)   the stroke at arc length s over its whole, measured with a ruler (teach.align), in COUNT even steps
    h, d   chord of the first part, up to s = c, and of as much again after it
    hook   the part before the c <= REACH at which h turns back into d most, if it does by more than TURN and is as
           long as LEAST of the drawing; a stroke's end is its beginning drawn backwards

A hook puts a motion's end where nobody meant it. But a motion that begins towards the camera looks like one: what most
other strokes of a view do too is meant, and of a single stroke nobody can tell. Longer ways back are kept.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from teach.align import arc_length, backwards
from teach.curve import extent
from teach.sketch import Sketch, Stroke
from teach.turns import piece

REACH, LEAST = 0.07, 0.01
"""The longest hook, of the arc length; the shortest, of the drawing's extent."""
TURN, EVEN, ALIKE = np.radians(100), 0.05, 0.6
"""How far a hook turns back; cosines that are taken for the same, of which the longest hook counts; hooks that differ by less than this share of their length are the same."""
COUNT = 400


def without_hooks(sketches: Sequence[Sketch]) -> tuple[list[Sketch], list[str]]:
    """The sketches without the hooks that single motion strokes have, and a sentence for each."""
    mended, notes = [], []
    for sketch in sketches:
        strokes = list(sketch.motions)
        for end, turned in (("begins", lambda one: one), ("ends", backwards)):
            shares = [hook(turned(stroke)) for stroke in strokes]
            chords = [_chord(turned(stroke), share) for stroke, share in zip(strokes, shares, strict=True)]
            for k, share in enumerate(shares):
                if share and not _meant(k, chords):
                    notes.append(f"Stroke {k + 1} on view {sketch.view} {end} with a hook of {np.linalg.norm(chords[k]):.0f} px, as a pen draws "
                                 "that lands or leaves; it is left out.")  # fmt: skip
                    strokes[k] = turned(_from(turned(strokes[k]), share))
        left = iter(strokes)
        mended.append(replace(sketch, strokes=tuple(next(left) if one.kind == "motion" else one for one in sketch.strokes)))
    return mended, notes


def hook(stroke: Stroke) -> float:
    """c, how much of the arc length the hook at the stroke's beginning is; 0 without one."""
    if len(np.unique(stroke.points, axis=0)) < 4:
        return 0.0
    s, even = arc_length(stroke), np.linspace(0, 1, COUNT)
    z = np.stack([np.interp(even, s, axis) for axis in stroke.points.T], axis=1)
    k = np.arange(2, int(REACH * COUNT) + 1)
    h, d = z[k] - z[0], z[2 * k] - z[k]
    length = np.linalg.norm(h, axis=1)
    along = (h * d).sum(axis=1) / np.maximum(length * np.linalg.norm(d, axis=1), 1e-300)
    turns = (along < np.cos(TURN)) & (along <= along.min() + EVEN) & (length >= LEAST * extent(z))
    return float(even[k[np.argmax(np.where(turns, length, 0.0))]]) if turns.any() else 0.0


def _chord(stroke: Stroke, share: float) -> np.ndarray:
    """h (2,) [px] of the stroke's first part."""
    along = arc_length(stroke)
    return np.array([np.interp(share, along, axis) for axis in stroke.points.T]) - stroke.points[0]


def _meant(k: int, chords) -> bool:
    """Whether most others of a view's strokes begin as the k-th does, or there are no others."""
    others = [np.linalg.norm(chord - chords[k]) < ALIKE * np.linalg.norm(chords[k]) for j, chord in enumerate(chords) if j != k]
    return 2 * sum(others) >= len(others)


def _from(stroke: Stroke, share: float) -> Stroke:
    """The stroke from that share of its arc length on; what happens before happens there."""
    number = np.arange(len(stroke.points))
    kept = piece(stroke, np.interp(share, arc_length(stroke), number), number[-1], stroke.events)
    return replace(kept, events=tuple(replace(event, time=max(event.time, float(kept.times[0]))) for event in kept.events))
