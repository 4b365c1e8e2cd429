"""How the hand is to be held along a motion, by what was chosen while drawing: kept, pointing down, or along a drawn arrow.

    {"kind": "keep"}                              as it is where the motion begins
    {"kind": "down"}                              its approach axis straight down
    {"kind": "along", "axis": [x, y, z]}          its approach axis along a direction of the world; in a sketch file the axis may
                                                  be missing, where strokes of kind "arrow" on two views draw it

Notation
    r_k(a)    unit ray of pixel a in view k, in the world
    n_k       r_k(tail) x r_k(tip), normal of the plane in which view k sees the arrow
    d         the arrow's direction: in every view's plane, so n_k . d = 0; the least right singular vector of the unit n_k. It leads
              from each tail's ray towards the tip's: (r_k(tip) - r_k(tail)) . (d across r_k(tail)) > 0
"""

from collections.abc import Sequence

import numpy as np

from scene.camera import Camera
from teach.sketch import Sketch, SketchError

STEEPEST = np.sin(np.radians(5))
"""Second singular value of the planes' normals below which the views see the arrow in nearly one plane."""
SHORTEST = 1e-6
"""Sine of the angle between an arrow's rays."""


def chosen(sketches: Sequence[Sketch]) -> dict | None:
    """What the sketches say of the hand, its axis (unit length) worked out; None where nothing is said. Raises SketchError."""
    said = [sketch.orientation for sketch in sketches if sketch.orientation]
    if not said:
        return None
    if any(other != said[0] for other in said):
        raise SketchError(f"the sketches hold the hand in different ways, {said[0]} and {next(o for o in said if o != said[0])}: choose one")
    if said[0]["kind"] != "along":
        return said[0]
    axis = said[0].get("axis")
    axis = drawn_axis(sketches) if axis is None else np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return {"kind": "along", "axis": axis.tolist()}


def drawn_axis(sketches: Sequence[Sketch]) -> np.ndarray:
    """Direction (3,) of the arrow that the last arrow stroke of each view draws. Raises SketchError."""
    drawn = [(sketch, sketch.arrows[-1].points[[0, -1]]) for sketch in sketches if sketch.arrows]
    if len(drawn) < 2:
        where = f"only on view {drawn[0][0].view!r}" if drawn else "on no view"
        raise SketchError(f"the hand's arrow is drawn {where}: its direction needs the same arrow on two views from different sides")
    try:
        return axis_of([sketch.camera for sketch, _ in drawn], [ends for _, ends in drawn])
    except ValueError as error:
        raise SketchError(f"the hand's arrow on views {', '.join(sketch.view for sketch, _ in drawn)}: {error}") from None


def axis_of(cameras: Sequence[Camera], ends: Sequence[np.ndarray]) -> np.ndarray:
    """Unit direction (3,) of an arrow whose tail and tip each camera sees at pixels ends (2, 2). Raises ValueError."""
    rays = np.array([camera.rays(pixels)[1] for camera, pixels in zip(cameras, ends, strict=True)])  # (K, 2, 3)
    normals = np.cross(rays[:, 0], rays[:, 1])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    if lengths.min() < SHORTEST:
        raise ValueError("it has no length on one of them; draw it longer")
    _, sizes, directions = np.linalg.svd(normals / lengths)
    if sizes[1] < STEEPEST:
        raise ValueError("they see it from nearly one side, in one plane; draw it on a view from another side")
    d = directions[-1]
    across = d - (rays[:, 0] @ d)[:, None] * rays[:, 0]
    ahead = np.sign(((rays[:, 1] - rays[:, 0]) * across).sum(axis=1))
    if (ahead != ahead[0]).any():
        raise ValueError("it points to opposite sides on them; draw it from the wrist to the fingertips on each")
    return d * ahead[0]
