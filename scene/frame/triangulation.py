"""One point from its pixels in many pictures, some of which may be wrong."""

from collections.abc import Sequence

import numpy as np

from scene.camera import Camera

INLIER_PX = 2.0
"""A pixel further than this from where all views together put its point is an outlier."""


def triangulate(
    pixels: np.ndarray, cameras: Sequence[Camera], threshold: float = INLIER_PX
) -> tuple[np.ndarray, np.ndarray]:
    """One point from its pixels (V, 2) in V cameras, some of which may be wrong.

    Every pair of views proposes a point; the one most views agree with, within ``threshold`` [px], is refined by them.
    Returns the point (3,) and which views agree (V,) bool; fewer than two, and a point of nan, if no two do.
    """
    P = np.array([camera.projection for camera in cameras]).reshape(-1, 3, 4)
    pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
    a, b = np.triu_indices(len(P), k=1)
    rows = pixels[..., None] * P[:, 2:] - P[:, :2]  # (V, 2, 4): u P3 - P1 and v P3 - P2 annihilate the point
    points = np.linalg.svd(np.concatenate([rows[a], rows[b]], axis=1))[2][:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = points[:, :3] / points[:, 3:]
        errors = reprojection(P, points[:, None], pixels)  # (pairs, V)
    if not len(points) or not (errors < threshold).sum(axis=1).max() >= 2:
        return np.full(3, np.nan), np.zeros(len(P), dtype=bool)
    best = np.minimum(np.nan_to_num(errors, nan=np.inf), threshold).sum(axis=1).argmin()
    return _refine_point(P, pixels, points[best], errors[best] < threshold, threshold)


def reprojection(P: np.ndarray, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Distance [px] between pixels (V, 2) and points (..., V or 1, 3) seen through P (V, 3, 4); nan behind a camera."""
    points = np.broadcast_to(points, (*points.shape[:-2], len(P), 3))
    seen = np.einsum("vij,...vj->...vi", P[:, :, :3], points) + P[:, :, 3]
    depth = np.where(seen[..., 2] > 1e-9, seen[..., 2], np.nan)
    return np.linalg.norm(seen[..., :2] / depth[..., None] - pixels, axis=-1)


def _refine_point(P, pixels, point, inside, threshold):
    """Least squares over the views that agree: the linear equations, each weighted by its inverse depth."""
    for _ in range(5):
        depth = point @ P[inside, 2, :3].T + P[inside, 2, 3]
        rows = (pixels[inside][..., None] * P[inside, 2:] - P[inside, :2]) / depth[:, None, None]
        rows = rows.reshape(-1, 4)
        point = np.linalg.lstsq(rows[:, :3], -rows[:, 3], rcond=None)[0]
        agree = reprojection(P, point[None], pixels) < threshold
        if agree.sum() < 2:
            break
        inside = agree
    return point, inside
