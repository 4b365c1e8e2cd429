"""Space as photographs know it: free, occupied, or never seen.

Notation
    z_c(x)      depth of a point x in camera c [m along the optical axis]
    d_c(x)      depth of what camera c sees where it would see x; inf where its ray meets nothing

    free        at least ``least`` cameras look past the voxel's centre: z_c < d_c
    occupied    the voxel holds a piece of surface, whoever looks past it
    unseen      neither: inside of things, behind them, outside of every picture, and where depth is not to be relied on
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from scene.camera import Camera
from scene.files import replacing

UNSEEN, FREE, OCCUPIED = 0, 1, 2
MOST = 40_000_000
"""Voxels a file may hold."""


@dataclass(frozen=True, eq=False)
class Space:
    """A box of cubic voxels. lower: (3,) its lowest corner [m]; voxel: their edge [m]; labels: (nx, ny, nz) uint8,
    UNSEEN, FREE or OCCUPIED."""

    lower: np.ndarray
    voxel: float
    labels: np.ndarray

    @property
    def upper(self) -> np.ndarray:
        """(3,) the highest corner [m]."""
        return self.lower + self.voxel * np.array(self.labels.shape)

    @property
    def unseen(self) -> np.ndarray:
        """(nx, ny, nz) bool."""
        return self.labels == UNSEEN

    def status(self, points) -> np.ndarray:
        """Points (..., 3) [m] -> (...,) uint8; what lies outside the box is UNSEEN."""
        index = np.floor((np.asarray(points, dtype=float) - self.lower) / self.voxel)
        inside = ((index >= 0) & (index < self.labels.shape)).all(-1)
        index = np.where(inside[..., None], index, 0).astype(int)
        return np.where(inside, self.labels[tuple(np.moveaxis(index, -1, 0))], UNSEEN).astype(np.uint8)

    def centres(self) -> np.ndarray:
        """(nx, ny, nz, 3) the voxels' centres [m]."""
        axes = [self.lower[i] + (np.arange(n) + 0.5) * self.voxel for i, n in enumerate(self.labels.shape)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1)

    def boxes(self, chosen: np.ndarray) -> np.ndarray:
        """(B, 2, 3) lowest and highest corners [m] of few boxes that fill the chosen voxels (nx, ny, nz) and no
        others."""
        left, found = chosen.copy(), []
        for start in np.argwhere(chosen):
            if left[tuple(start)]:
                stop = _grown(left, start)
                left[tuple(slice(a, b) for a, b in zip(start, stop))] = False
                found.append((start, stop))
        return self.lower + self.voxel * np.array(found, dtype=float).reshape(-1, 2, 3)

    def save(self, path: str | Path) -> None:
        """Write an npz file, whole or not at all."""
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, lower=self.lower, voxel=self.voxel, labels=self.labels)

    @classmethod
    def load(cls, path: str | Path) -> "Space":
        """Read what ``save`` wrote. Raises FileNotFoundError, or ValueError for any other file."""
        if not Path(path).is_file():
            raise FileNotFoundError(f"no {path}: python -m scene.mesh makes it from a trained field")
        try:
            with np.load(path, allow_pickle=False) as file:
                lower, voxel, labels = file["lower"].astype(float), float(file["voxel"]), file["labels"]
        except (ValueError, KeyError, TypeError, EOFError, OSError, BadZipFile) as error:
            raise ValueError(f"{path} does not say what is free ({error}); make it anew with scene.mesh") from None
        whole = lower.shape == (3,) and np.isfinite(lower).all() and 0 < voxel < np.inf and labels.ndim == 3
        if not (whole and labels.dtype == np.uint8 and labels.size <= MOST and (labels <= OCCUPIED).all()):
            raise ValueError(f"{path} does not say what is free; make it anew with scene.mesh")
        return cls(lower, voxel, labels)


def carve(
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    surface: np.ndarray,
    lower,
    upper,
    voxel: float,
    least: int = 2,
) -> Space:
    """Free, occupied and unseen voxels of the box between two corners (3,) [m].

    depths: for each camera (h, w) [m along z] of what it sees; inf: nothing, nan: not known. surface: (N, 3) points of
    all surfaces, no further from each other than a voxel. least: cameras that must look past a voxel. """
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    shape = np.maximum(np.ceil((upper - lower) / voxel - 1e-9).astype(int), 1)
    if np.prod(shape.astype(float)) > MOST:
        raise ValueError(f"{' x '.join(map(str, shape))} voxels of {voxel:g} are too many: choose larger ones")
    space = Space(lower, float(voxel), np.zeros(shape, np.uint8))
    centres = space.centres().reshape(-1, 3)
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], 1).astype(np.float32)
    past = np.zeros(len(centres), np.uint8)
    for camera, depth in zip(cameras, depths, strict=True):
        past += _looks_past(camera, depth, homogeneous) & (past < 255)
    labels = np.where(past >= least, FREE, UNSEEN).astype(np.uint8).reshape(space.labels.shape)
    index = np.floor((np.asarray(surface, dtype=float).reshape(-1, 3) - lower) / voxel).astype(int)
    index = index[((index >= 0) & (index < shape)).all(1)]
    labels[tuple(index.T)] = OCCUPIED
    return Space(lower, float(voxel), labels)


def _looks_past(camera: Camera, depth: np.ndarray, homogeneous: np.ndarray) -> np.ndarray:
    """(N,) bool: which of the points (N, 4) the camera sees something behind."""
    x, y, z = camera.projection.astype(np.float32) @ homogeneous.T
    ahead = np.flatnonzero((z > 0) & (x >= 0) & (x < z * camera.width) & (y >= 0) & (y < z * camera.height))
    column, row = ((v[ahead] / z[ahead]).astype(int) for v in (x, y))
    past = np.zeros(len(homogeneous), bool)
    past[ahead] = z[ahead] < depth[np.minimum(row, camera.height - 1), np.minimum(column, camera.width - 1)]
    return past


def _grown(left: np.ndarray, start: np.ndarray) -> np.ndarray:
    """How far a box of chosen voxels reaches from its first one: along z, then y, then x."""
    stop = start + 1
    for axis in (2, 1, 0):
        while stop[axis] < left.shape[axis]:
            layer = [slice(a, b) for a, b in zip(start, stop)]
            layer[axis] = stop[axis]
            if not left[tuple(layer)].all():
                break
            stop[axis] += 1
    return stop
