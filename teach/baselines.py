"""What RPTL is compared with (the paper's Table I): a straight line, and the strokes of the nearest view.

Both give curves in the held-out view [px], as ``teach.metrics.mfd`` and ``teach.metrics.wd`` take them.
"""

from collections.abc import Sequence

import numpy as np

from scene.camera import Camera
from teach.curve import resample
from teach.sketch import Sketch


def linear(strokes, count: int = 100) -> np.ndarray:
    """(count, 2) px: the straight line from the mean start to the mean end of the held-out strokes, which it is given.

    strokes: sequence of (N_i, 2) px. It has no spread: its one sample is itself.
    """
    start, end = np.mean([np.asarray(stroke, dtype=float)[[0, -1]] for stroke in strokes], axis=0)
    return start + np.linspace(0, 1, count)[:, None] * (end - start)


def nearest_neighbour(training: Sequence[Sketch], held_out: Camera, count: int = 100) -> np.ndarray:
    """(n, count, 2) px: the strokes of the training view nearest to the held-out camera, at equal arc length.

    The same pixels are read in another picture; where the two pictures differ in size, pixels scale with them. Its
    samples are the strokes, its mean is theirs.
    """
    nearest = min(training, key=lambda sketch: pose_distance(sketch.camera, held_out))
    scale = np.array([held_out.width / nearest.camera.width, held_out.height / nearest.camera.height])
    return np.stack([resample(stroke.points * scale, count) for stroke in nearest.motions])


def pose_distance(a: Camera, b: Camera) -> tuple[float, float]:
    """How far apart two cameras are, to be ordered: angle of the rotation between them [whole degrees], distance [m].

    The angle comes first because it needs no scale, which a reconstruction without tags does not have; it is rounded so
    that among cameras turned alike the distance decides.
    """
    a_from_b = a.world_from_camera[:3, :3].T @ b.world_from_camera[:3, :3]
    angle = np.degrees(np.arccos(np.clip((np.trace(a_from_b) - 1) / 2, -1, 1)))
    return float(np.round(angle)), float(np.linalg.norm(a.centre - b.centre))
