"""What two views know of each other: the epipolar geometry, and which moments of two strokes it lets correspond.

Notation
    F               fundamental matrix: (b, 1)^T F (a, 1) = 0 for pixels a, b of the same point
    e(a, b)         signed Sampson distance [px] (Hartley and Zisserman 2004, eq. 11.9)
    l(u)            lag: one curve at u - l / 2 and another at u + l / 2 show the same moment; u in [0, 1]
"""

import numpy as np

from scene.camera import Camera
from teach.lag import at, best_lag


def fundamental(camera_a: Camera, camera_b: Camera) -> np.ndarray:
    """F (3, 3) of two cameras, scaled to norm 1."""
    epipole = camera_b.projection @ np.append(camera_a.centre, 1.0)
    cross = np.array([[0, -epipole[2], epipole[1]], [epipole[2], 0, -epipole[0]], [-epipole[1], epipole[0], 0]])
    F = cross @ camera_b.projection @ np.linalg.pinv(camera_a.projection)
    return F / np.linalg.norm(F)


def sampson(a, b, F) -> np.ndarray:
    """Signed Sampson distance (N,) [px] of pixels a and b (N, 2): to first order how far all four numbers must move,
    RSS."""
    a, b = (np.column_stack([x, np.ones(len(x))]) for x in (a, b))
    lines_b, lines_a = a @ F.T, b @ F  # epipolar lines of a in the picture of b, and of b in the picture of a
    gradient = np.sqrt((lines_b[:, :2] ** 2).sum(-1) + (lines_a[:, :2] ** 2).sum(-1))
    return (lines_b * b).sum(-1) / np.maximum(gradient, 1e-300)


def lag_between(a, b, F, sigma: float, size: float) -> tuple[np.ndarray, float]:
    """The best lag (N,) between two views' curves (N, 2) [px], and its cost.

    As ``best_lag`` has it, of the distance e; sigma: of e [px].
    """
    return best_lag(lambda u, lag: sampson(at(a, u - lag / 2), at(b, u + lag / 2), F), len(a), sigma, size)
