"""Where up is and where the middle is, from cameras and points alone.

People hold cameras level and stand things on flat ground: that fixes up to a degree or two, without any tool.
"""

from collections.abc import Sequence

import numpy as np

from scene.camera import Camera
from scene.frame.similarity import Similarity
from scene.model import Model


def align(model: Model) -> Similarity:
    """A frame for a scene without a measure: z up, origin at the middle of the scene, the median camera at distance 1.

    x points right in the first photograph. The scale is arbitrary.
    """
    cameras, points = model.cameras, np.asarray(model.points, dtype=float).reshape(-1, 3)
    rotation, origin = level(up(cameras, points), cameras[0]), middle(cameras, points)
    scale = 1 / np.median([np.linalg.norm(camera.centre - origin) for camera in cameras])
    return Similarity(
        float(scale), rotation, -scale * rotation @ origin, frame="arbitrary",
        rests_on="the way the cameras were held: z is up, scale and place are arbitrary",
    )  # fmt: skip


def level(up: np.ndarray, camera: Camera, forward: np.ndarray | None = None) -> np.ndarray:
    """level_from_model (3, 3): z along ``up``, x along ``forward`` (3,) or to the right in ``camera``."""
    x = camera.world_from_camera[:3, 0] if forward is None else forward
    x = x - up * (up @ x)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross(camera.forward, up)
    x = x / np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def up(cameras: Sequence[Camera], points: np.ndarray) -> np.ndarray:
    """The unit vector (3,) up, in the frame of the cameras and points (N, 3).

    Up is where upright cameras have it (their x axes are level), corrected to the normal of the plane most of the
    points lie on if that is within 20 degrees.
    """
    poses = np.array([camera.world_from_camera for camera in cameras])
    return _up_of_plane(np.asarray(points, dtype=float).reshape(-1, 3), _up_of_cameras(poses))


def middle(cameras: Sequence[Camera], points: np.ndarray) -> np.ndarray:
    """The point (3,) closest to all optical axes; the median of the points where the axes are nearly parallel."""
    poses = np.array([camera.world_from_camera for camera in cameras])
    forward = poses[:, :3, 2]
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    A = across.sum(axis=0)
    if np.linalg.cond(A) < 100 or not len(points):
        return np.linalg.lstsq(A, np.einsum("vij,vj->i", across, poses[:, :3, 3]), rcond=None)[0]
    return np.median(points, axis=0)


def _up_of_cameras(poses: np.ndarray) -> np.ndarray:
    """The direction most perpendicular to all x axes, on the side of -y; the mean -y if cameras stand in a row."""
    mean = -poses[:, :3, 1].mean(axis=0)
    _, spread, axes = np.linalg.svd(poses[:, :3, 0])
    level = axes[-1] * np.sign(axes[-1] @ mean)
    up = level if len(poses) >= 3 and spread[1] > 0.2 * spread[0] and np.any(level) else mean
    return up / np.linalg.norm(up)


def _up_of_plane(points: np.ndarray, up: np.ndarray, trials: int = 500) -> np.ndarray:
    """The normal of the plane with most points, if near ``up`` and through a third of them; else ``up``."""
    if len(points) < 30:
        return up
    rng = np.random.default_rng(0)
    thickness = 0.01 * np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    a, b, c = np.moveaxis(points[rng.integers(0, len(points), (trials, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 1e-12, lengths, np.inf)
    upright = np.abs(normals @ up) > np.cos(np.radians(20))
    counts = [(np.abs((points - p) @ n) < thickness).sum() if ok else 0 for p, n, ok in zip(a, normals, upright)]
    best = int(np.argmax(counts))
    if counts[best] < len(points) / 3:
        return up
    plane = points[np.abs((points - a[best]) @ normals[best]) < thickness]
    normal = np.linalg.svd(plane - plane.mean(axis=0))[2][-1]
    return normal * np.sign(normal @ up)
