"""transforms.json as others write it: pictures with their cameras, and lenses that bend.

    nerfstudio     w h fl_x fl_y cx cy, camera_model, k1 k2 k3 p1 p2 (k1..k4 of a fisheye), for all or for one frame;
                   mask_path: black where a picture is not to be looked at; applied_transform: how its frame came from the original one; ply_file_path: points, in its frame
    instant-ngp    the same, or camera_angle_x [rad] for the focal length; is_fisheye; w and h may be missing
    NeRF's blender scenes: camera_angle_x, and file_path without an ending

transform_matrix is world_from_camera with OpenGL axes, in whatever frame and scale the file has; both stay as they
are. cx, cy are COLMAP's (see scene.dataset). A file of our own says under "scene2skill" which frame that is.
"""

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from scene.camera import OPENCV_FROM_OPENGL, Camera
from scene.dataset import EXTENSIONS, inside, load_transforms
from scene.masks import check as check_mask

PERSPECTIVE = ("", "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE", "FULL_OPENCV")
FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")


@dataclass(frozen=True)
class Posed:
    """Pictures with known cameras.

    names: (N,) of the pictures, relative to ``root``. lenses: (N,) of COLMAP's model, width, height, params.
    poses: (N, 4, 4) world_from_camera, OpenCV axes. ply: file of points in the same frame, if there is one.
    masks: {name: file} of pictures with a mask. frame: as in scene.dataset.load_frame. original: (4, 4) how that frame came from an earlier one.
    """

    root: Path
    names: tuple[str, ...]
    lenses: tuple[dict, ...]
    poses: np.ndarray
    ply: Path | None = None
    frame: dict = field(default_factory=lambda: {"name": "arbitrary", "unit": "arbitrary"})
    original: np.ndarray = field(default_factory=lambda: np.eye(4))
    masks: dict = field(default_factory=dict)

    def files(self) -> list[Path]:
        """The pictures and their masks."""
        return [self.root / name for name in self.names] + list(self.masks.values())


def read(path: str | Path) -> Posed:
    """The cameras of a transforms.json and the names of their pictures, which are not decoded here.

    Raises FileNotFoundError (no file, missing pictures) or ValueError (missing keys, matrices that are no poses,
    pictures outside its folder, lenses that COLMAP does not know).
    """
    path = Path(path)
    meta = load_transforms(path)
    files, lenses, poses, masks = [], [], [], {}
    for i, frame in enumerate(meta["frames"]):
        where = f"{path}, frame {i}"
        missing = [key for key in ("file_path", "transform_matrix") if key not in frame]
        if missing:
            raise ValueError(f"{where}: missing {', '.join(missing)}")
        where = f"{where} ({frame['file_path']})"
        files.append(_picture(path.parent, frame["file_path"], where))
        lenses.append(lens_of(_sized(meta | frame, files[-1]), where))
        poses.append(_pose(frame["transform_matrix"], where))
        if frame.get("mask_path"):
            masks[files[-1]] = inside(path.parent, frame["mask_path"], where)
            check_mask(masks[files[-1]], (lenses[-1]["height"], lenses[-1]["width"]))
    root = Path(os.path.commonpath([file.parent for file in files]))
    names = tuple(file.relative_to(root).as_posix() for file in files)
    ply = inside(path.parent, meta["ply_file_path"], str(path)) if meta.get("ply_file_path") else None
    extra = meta.get("scene2skill") if isinstance(meta.get("scene2skill"), dict) else {}
    known = extra.get("frame") if isinstance(extra.get("frame"), dict) else {}
    frame = {"name": "arbitrary", "unit": "arbitrary"} | known
    original = extra.get("world_from_original") or meta.get("applied_transform") or np.eye(4)
    masks = {file.relative_to(root).as_posix(): mask for file, mask in masks.items()}
    return Posed(root, names, tuple(lenses), np.stack(poses), ply, frame, _transform(original, str(path)), masks)


def _picture(folder: Path, file_path, where: str) -> Path:
    """A picture inside ``folder``; NeRF's own scenes leave its ending away."""
    named = Path(str(file_path))
    if not named.suffix:
        endings = [ending for ending in EXTENSIONS if (folder / f"{named}{ending}").is_file()]
        named = Path(f"{named}{endings[0]}") if endings else named
    return inside(folder, str(named), where)


def _sized(said: dict, picture: Path) -> dict:
    """What is said of a picture, with its size if that is not said."""
    if said.get("w") is not None and said.get("h") is not None:
        return said
    with Image.open(picture) as image:
        width, height = image.size
    return said | {"w": width, "h": height}


def lens_of(said: dict, where: str) -> dict:
    """COLMAP's camera model and its parameters, of intrinsics under transforms.json's keys; ValueError beginning with ``where``."""
    width, height = said.get("w"), said.get("h")
    if said.get("fl_x") is None and said.get("camera_angle_x") is None:
        raise ValueError(f"{where}: missing fl_x (or camera_angle_x)")
    try:
        width, height = float(width), float(height)
        fl_x = _focal(said, "fl_x", "camera_angle_x", width) or 0.0
        fl_y = _focal(said, "fl_y", "camera_angle_y", height) or fl_x
        centre = [float(said.get("cx", width / 2)), float(said.get("cy", height / 2))]
        bend = {key: float(said.get(key) or 0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")}
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: intrinsics must be numbers: {error}") from error
    if not (min(width, height) >= 1 and width % 1 == height % 1 == 0 and min(fl_x, fl_y) > 0):
        raise ValueError(f"{where}: w, h, fl_x, fl_y must be positive, and w, h whole numbers")
    if not np.isfinite([fl_x, fl_y, *centre, *bend.values()]).all():
        raise ValueError(f"{where}: intrinsics must be finite numbers")
    model, more = _model(said, bend, where)
    return {"model": model, "width": int(width), "height": int(height), "params": [fl_x, fl_y, *centre, *more]}


def _focal(said: dict, length: str, angle: str, size: float) -> float | None:
    if said.get(length) is not None:
        return float(said[length])
    return size / 2 / math.tan(float(said[angle]) / 2) if said.get(angle) else None


def _model(said: dict, bend: dict, where: str) -> tuple[str, list[float]]:
    kind = str(said.get("camera_model") or "").upper()
    if kind in FISHEYE or said.get("is_fisheye"):
        return "OPENCV_FISHEYE", [bend[key] for key in ("k1", "k2", "k3", "k4")]
    if kind not in PERSPECTIVE or bend["k4"]:
        raise ValueError(f"{where}: a lens of {kind or 'a perspective camera'} with k4 {bend['k4']:g} is not read")
    usual = [bend[key] for key in ("k1", "k2", "p1", "p2")]
    if bend["k3"]:
        return "FULL_OPENCV", [*usual, bend["k3"], 0.0, 0.0, 0.0]
    return ("OPENCV", usual) if any(usual) else ("PINHOLE", [])


def _pose(matrix, where: str) -> np.ndarray:
    pose = _transform(matrix, where)
    try:
        return Camera(np.eye(3), pose @ OPENCV_FROM_OPENGL, 1, 1).world_from_camera
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _transform(matrix, where: str) -> np.ndarray:
    """(4, 4), also of its upper three rows alone."""
    try:
        rows = np.array(matrix, dtype=float)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape == (3, 4):
        rows = np.concatenate([rows, [[0, 0, 0, 1]]])
    if rows.shape != (4, 4) or not np.isfinite(rows).all() or not np.allclose(rows[3], [0, 0, 0, 1]):
        raise ValueError(f"{where}: a transform must be 4x4 finite numbers with 0 0 0 1 as its last row")
    return rows
