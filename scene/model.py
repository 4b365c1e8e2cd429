"""What structure from motion hands on: cameras and points in a frame of their own (scene.frame brings them to the robot)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scene.camera import Camera, View
from scene.dataset import MASKS, load_image, read_mask


class ReconstructionFailed(ValueError):
    """The photographs could not be joined to one model."""


@dataclass(frozen=True, eq=False)
class Model:
    """What structure from motion found, in its own frame.

    names: of the registered photographs, sorted, without extension. cameras: pinholes, one each. images: files of the
    undistorted pictures. points: (N, 3); colours: (N, 3) uint8; point_errors: (N,) mean reprojection error [px].
    total: photographs given. reprojection_px: mean over all observations, in pixels of the photographs as they were.
    unregistered: names of those left out. sparse: folder of the COLMAP model.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    images: tuple[Path, ...]
    points: np.ndarray
    colours: np.ndarray
    point_errors: np.ndarray
    total: int
    reprojection_px: float
    unregistered: tuple[str, ...]
    sparse: Path

    @property
    def registered(self) -> int:
        """Number of photographs in the model."""
        return len(self.names)

    def views(self) -> list[View]:
        """The undistorted pictures with their cameras, in the model's frame."""
        files = [self.sparse.parents[2] / MASKS / f"{name}.png" for name in self.names]
        masks = [read_mask(file) if file.is_file() else None for file in files]
        return [View(*parts) for parts in zip(self.names, self.cameras, map(load_image, self.images), masks, strict=True)]

    @classmethod
    def load(cls, work: str | Path) -> "Model":
        """The model that ``reconstruct`` left in its work folder."""
        work = Path(work)
        with np.load(work / "colmap" / "model.npz", allow_pickle=False) as file:
            parts = dict(file)
        cameras = zip(parts["K"], parts["world_from_camera"], *parts["sizes"].T, strict=True)
        return cls(
            names=tuple(parts["names"].tolist()),
            cameras=tuple(Camera(*camera) for camera in cameras),
            images=tuple(work / "images" / name for name in parts["images"].tolist()),
            **{key: parts[key] for key in ("points", "colours", "point_errors")},
            total=int(parts["total"]),
            reprojection_px=float(parts["reprojection_px"]),
            unregistered=tuple(parts["unregistered"].tolist()),
            sparse=work / "colmap" / "sparse" / "0",
        )
