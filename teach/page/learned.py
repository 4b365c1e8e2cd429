"""What the page shows of a learned skill: numbers that every view can project and the 3D view can draw.

Runs in the worker's process. ``fit(sketches, seen=...)`` is teach.rptl.fit with its settings; what it makes is kept
beside the sketches as .learned/<name>.npz, for checking and performing.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from teach.hull import visual_hull
from teach.orientation import chosen
from teach.page.store import parse, revision_of
from teach.sketch import Sketch, SketchError
from teach.trajectory import Skill

TIMES = np.linspace(0, 1, 81)
SAMPLES = 14


def learn(fit: Callable, progress: Callable, path: Path, keep: Path) -> dict:
    """Learn what the sketch file ``path`` draws, write the skill to ``keep``, return what the page shows. Raises SketchError."""
    body = path.read_bytes()
    progress(0.05, "Looking at the strokes")
    sketches = parse(body)
    views = max(len([sketch for sketch in sketches if sketch.motions]), 1)
    done = []

    def seen(sketch, density):
        done.append(sketch.view)
        progress(0.2 + 0.7 * len(done) / views, f"Learned from {sketch.view}")

    sketches, unfinished = _finished(sketches)
    skill = fit(sketches, seen=seen)
    progress(0.95, "Drawing the motion")
    skill.save(keep)
    there = shown(skill)
    return there | {"revision": revision_of(body), "unfinished": unfinished, "warnings": unfinished + there["warnings"]}


def _finished(sketches) -> tuple[list[Sketch], list[str]]:
    """The sketches, without outlines as long as these bound nothing and without an arrow that has no direction yet: the motion is
    shown all the same, and why they do not count yet."""
    unfinished = []
    try:
        visual_hull(sketches)
    except SketchError as error:
        sketches = [replace(s, strokes=(*s.motions, *s.arrows)) for s in sketches]
        unfinished.append(f"Not kept clear of yet: {error}.")
    try:
        chosen(sketches)
    except SketchError as error:
        sketches = [replace(s, orientation=None) for s in sketches]
        unfinished.append(f"The hand does not point yet: {error}.")
    return sketches, unfinished


def shown(skill: Skill) -> dict:
    """Plain numbers: times (T,), for each way its share, mean (T, 3) [m], samples (S, T, 3), covariance (T, 3, 3) [m^2];
    duration [s], axis (3,) along which the hand points or None, events, the report's sentences and weakest part, of keep-out volumes the edges (E, 2, 3) [m] and convex pieces."""
    return {
        "times": TIMES.tolist(),
        "ways": [_way(way) for way in skill.ways],
        "duration": skill.duration,
        "axis": [0.0, 0.0, -1.0] if skill.hand == "down" else skill.hand if isinstance(skill.hand, list) else None,
        "events": [{"name": event.name, "time": event.time} for event in skill.events],
        "sentence": skill.report.get("sentence", ""),
        "warnings": skill.report.get("warnings", []),
        "weakest": skill.report.get("weakest"),
        "seconds": skill.report.get("seconds"),
        "regions": [_region(region) for region in visual_hull(skill.keep_out)],
    }


def _region(region) -> dict:
    pieces = [{"vertices": vertices.round(4).tolist(), "faces": faces.tolist()} for vertices, faces in region.pieces]
    return {"edges": region.edges.round(4).tolist(), "pieces": pieces}


def _way(way) -> dict:
    samples = way.distribution.sample(SAMPLES, TIMES, np.random.default_rng(0))
    return {
        "share": way.share,
        "mean": way.distribution.mean_at(TIMES).round(5).tolist(),
        "samples": samples.round(4).tolist(),
        "covariance": [[float(f"{x:.4g}") for x in C.ravel()] for C in way.distribution.covariance_at(TIMES)],
    }
