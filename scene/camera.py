"""Pinhole cameras: how a point becomes a pixel, and a pixel a ray.

Notation
    x_camera = R^T (x_world - o)         R, o: rotation and translation of ``world_from_camera``
    (u, v, 1)^T z = K x_camera           u, v in pixels, z the depth along the optical axis in metres

Camera axes are OpenCV's: x right, y down, z forward. Pixel (0, 0) is the top-left corner of the
top-left pixel, whose centre is (0.5, 0.5), as COLMAP has it.
"""

from dataclasses import dataclass, replace

import numpy as np

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL cameras (nerfstudio, PyBullet) look along -z with y up; the matrix is its own inverse."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    K: (3, 3) intrinsics [px]. world_from_camera: (4, 4) rigid transform [m]. width, height: [px].
    """

    K: np.ndarray
    world_from_camera: np.ndarray
    width: int
    height: int

    def __post_init__(self):
        K = np.array(self.K, dtype=float)
        pose = np.array(self.world_from_camera, dtype=float)
        if K.shape != (3, 3) or pose.shape != (4, 4):
            raise ValueError(f"a camera has K (3, 3) and a pose (4, 4), not {K.shape} and {pose.shape}")
        if not (np.isfinite(K).all() and np.isfinite(pose).all()):
            raise ValueError("a camera's intrinsics and pose must be finite numbers")
        if not np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-4) or np.linalg.det(pose[:3, :3]) < 0:
            raise ValueError("a camera's pose must have an orthonormal, right-handed rotation")
        for array in (K, pose):
            array.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "world_from_camera", pose)
        object.__setattr__(self, "width", int(self.width))
        object.__setattr__(self, "height", int(self.height))

    @classmethod
    def from_fov(cls, world_from_camera, width, height, fov_deg):
        """Square pixels, principal point at the middle, ``fov_deg`` the horizontal field of view [deg]."""
        focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return cls(K, world_from_camera, width, height)

    def plain(self) -> dict:
        """As plain numbers, for JSON: Camera(**camera.plain()) is the same camera."""
        return {"K": self.K.tolist(), "world_from_camera": self.world_from_camera.tolist(), "width": self.width, "height": self.height}

    @property
    def centre(self) -> np.ndarray:
        """Optical centre in the world (3,) [m]."""
        return self.world_from_camera[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Unit vector of the optical axis in the world (3,)."""
        return self.world_from_camera[:3, 2]

    @property
    def camera_from_world(self) -> np.ndarray:
        """(4, 4) inverse of the pose."""
        return invert(self.world_from_camera)

    @property
    def projection(self) -> np.ndarray:
        """P = K [R^T | -R^T o], (3, 4)."""
        return self.K @ self.camera_from_world[:3]

    def project(self, points) -> np.ndarray:
        """World points (..., 3) [m] -> pixels (..., 2); nan where a point is not in front of the camera."""
        pixels_times_depth = np.asarray(points, dtype=float) @ self.projection[:, :3].T + self.projection[:, 3]
        depth = pixels_times_depth[..., 2:]
        return pixels_times_depth[..., :2] / np.where(depth > 1e-9, depth, np.nan)

    def jacobian(self, points) -> np.ndarray:
        """Derivative (..., 2, 3) [px/m] of ``project`` at world points (..., 3) [m] in front of the camera."""
        P = self.projection
        homogeneous = np.asarray(points, dtype=float) @ P[:, :3].T + P[:, 3]
        pixels, depth = homogeneous[..., :2] / homogeneous[..., 2:], homogeneous[..., 2]
        return (P[:2, :3] - pixels[..., None] * P[2:, :3]) / depth[..., None, None]

    def depth(self, points) -> np.ndarray:
        """Depth (...,) [m] along the optical axis of world points (..., 3)."""
        return (np.asarray(points, dtype=float) - self.centre) @ self.forward

    def rays(self, pixels) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) -> origins (..., 3) and unit directions (..., 3) in the world."""
        pixels = np.asarray(pixels, dtype=float)
        homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
        directions = homogeneous @ np.linalg.inv(self.K).T @ self.world_from_camera[:3, :3].T
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(self.centre, directions.shape), directions

    def pixel_centres(self) -> np.ndarray:
        """(height, width, 2) pixel coordinates of all pixel centres."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)

    def contains(self, pixels) -> np.ndarray:
        """(...,) bool: which pixels (..., 2) lie inside the picture (nan does not)."""
        pixels = np.asarray(pixels, dtype=float)
        return ((pixels >= 0) & (pixels <= [self.width, self.height])).all(axis=-1)

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another picture size."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def cropped(self, width: int, height: int) -> "Camera":
        """The camera with a picture of another shape, cropped (never stretched) about the principal point."""
        focal = self.K[0, 0] * max(width / self.width, height / self.height)
        return replace(self, K=[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], width=width, height=height)

    def moved(self, to_from_world) -> "Camera":
        """The camera seen from another frame: ``to_from_world`` (4, 4) is a rigid transform or similarity."""
        pose = np.asarray(to_from_world, dtype=float) @ self.world_from_camera
        pose[:3, :3] /= np.cbrt(np.linalg.det(pose[:3, :3]))
        return replace(self, world_from_camera=pose)


@dataclass(frozen=True, eq=False)
class View:
    """A picture with its camera. image: (height, width, 3) uint8 RGB; mask: (height, width) bool, False where it is not to be
    looked at, or None."""

    name: str
    camera: Camera
    image: np.ndarray
    mask: np.ndarray | None = None

    def __post_init__(self):
        if self.mask is not None and (self.mask.shape != self.image.shape[:2] or self.mask.dtype != bool):
            raise ValueError(f"view {self.name}: mask must be bool {self.image.shape[:2]}, not {self.mask.dtype} {self.mask.shape}")
        expected = (self.camera.height, self.camera.width, 3)
        if self.image.shape != expected or self.image.dtype != np.uint8:
            raise ValueError(f"view {self.name}: image must be uint8 {expected}, not {self.image.dtype} {self.image.shape}")


def invert(a_from_b) -> np.ndarray:
    """Inverse (4, 4) of a rigid transform (4, 4)."""
    R, o = a_from_b[:3, :3], a_from_b[:3, 3]
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = R.T
    b_from_a[:3, 3] = -R.T @ o
    return b_from_a


def look_at(eye, target, up=(0, 0, 1)) -> np.ndarray:
    """``world_from_camera`` (4, 4) of a camera at ``eye`` whose optical axis passes through ``target`` (3,) [m]."""
    eye, target, up = (np.asarray(v, dtype=float) for v in (eye, target, up))
    z = target - eye
    if np.linalg.norm(z) < 1e-9:
        raise ValueError("a camera cannot look at the point it stands at")
    z = z / np.linalg.norm(z)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-6:  # looking along up: any right hand will do
        x = np.cross(z, [0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :4] = np.stack([x, np.cross(z, x), z, eye], axis=1)
    return world_from_camera


def orbit(target, radius, elevation_deg, count, start_deg=0.0, sweep_deg=360.0) -> list[np.ndarray]:
    """``count`` poses (4, 4) on a circle around the vertical axis through ``target``, all looking at it.

    Azimuth 0 is the +x side of the target; the first pose stands at ``start_deg``, the next ones
    follow counter-clockwise over ``sweep_deg``. A full circle does not repeat its first pose.
    """
    step = sweep_deg / (count if abs(sweep_deg) >= 360 else max(count - 1, 1))
    azimuth = np.radians(start_deg + step * np.arange(count))
    elevation = np.radians(elevation_deg)
    offsets = radius * np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.full(count, np.sin(elevation))], axis=1
    )
    return [look_at(np.asarray(target, dtype=float) + offset, target) for offset in offsets]


def nearest_to_rays(origins, directions) -> np.ndarray:
    """The points (..., 3) nearest to rays (..., V, 3), (..., V, 3): least squares, sum_v (I - d_v d_v^T) (x - o_v) = 0.

    Where all rays are parallel, of the points that are equally near the one nearest to the world's origin.
    """
    origins, directions = np.asarray(origins, dtype=float), np.asarray(directions, dtype=float)
    across = np.eye(3) - directions[..., :, None] * directions[..., None, :]  # projection across each ray
    pull = np.einsum("...vij,...vj->...i", across, origins)
    return (np.linalg.pinv(across.sum(axis=-3), hermitian=True) @ pull[..., None])[..., 0]


def ray_distance(origins_a, directions_a, origins_b, directions_b) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closest approach of lines a and b, all (..., 3) with unit directions.

    Returns the distances along a and along b (...,) [m] and the gap between the two closest
    points (...,) [m]; nan along lines that are parallel.
    """
    w = np.asarray(origins_b) - np.asarray(origins_a)
    cosine = (directions_a * directions_b).sum(-1)
    sine2 = 1 - cosine**2
    sine2 = np.where(sine2 > 1e-12, sine2, np.nan)
    wa, wb = (w * directions_a).sum(-1), (w * directions_b).sum(-1)
    along_a = (wa - cosine * wb) / sine2
    along_b = (cosine * wa - wb) / sine2
    gap = w + along_b[..., None] * directions_b - along_a[..., None] * directions_a
    return along_a, along_b, np.linalg.norm(gap, axis=-1)
