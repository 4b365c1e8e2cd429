"""Cameras from AprilTags alone: two photographs are enough, and no COLMAP (the paper's set-up with a real robot).

What is found is known as far as the photographs show tags (scene.resection.pnp); the focal length comes from a camera file, or
else from the tags and the photographs' EXIF. """

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from scene import album
from scene.dataset import is_rotated, load_image, save_image, save_points
from scene.files import parse_json
from scene.frame.apriltag import TagLayout, detect
from scene.model import ReconstructionFailed
from scene.resection.pnp import solve
from scene.transforms import Posed, lens_of

FULL_FRAME_DIAGONAL = 43.27  # mm, which EXIF's equivalent focal lengths refer to


def resect(
    photographs: Sequence[Path], layout: TagLayout, work: str | Path, *, camera: str | Path | None = None
) -> Posed:
    """Photographs (one camera, one size) with tags -> their cameras in the robot's base; upright copies lie in
    ``work``.

    camera: a JSON file of intrinsics, with transforms.json's keys; without it the focal length comes from the tags and
    EXIF. Raises ReconstructionFailed where fewer than two photographs show tags, tags contradict each other, or a pose
    or the focal length stays open; ValueError for a broken camera file. """
    root = Path(work) / "upright"
    if len({album.size(path) for path in photographs}) > 1:
        cameras = album.described(album.cameras(photographs))
        raise ReconstructionFailed(f"tags alone give the cameras of photographs of one camera only; here are {cameras}")
    files = {name: _upright(name, path, root) for name, path in album.named(photographs).items()}
    pictures = {name: load_image(path) for name, path in files.items()}
    height, width = next(iter(pictures.values())).shape[:2]
    found = {name: _known(detect(image), layout) for name, image in pictures.items()}
    blind = [name for name in found if not found[name]]
    if len(found) - len(blind) < 2:
        raise ReconstructionFailed(
            f"{len(found) - len(blind)} of {len(found)} photographs show a tag of the layout "
            f"({', '.join(map(str, layout.ids))}), and two are needed: check the numbers in "
            "tags.json, and photograph the tags larger and sharper"
        )
    lens = _lens(camera, width, height)
    prior = None if lens else _exif_focal(photographs, width, height)
    shown = {name: corners for name, corners in found.items() if corners}
    straight = {name: {n: _straightened(c, lens) for n, c in corners.items()} for name, corners in shown.items()}
    solved = solve(straight, layout, (width, height), lens and _matrix(lens), prior)
    pinhole = [solved.focal, solved.focal, width / 2, height / 2]
    lens = lens or {"model": "PINHOLE", "width": width, "height": height, "params": pinhole}
    if blind:
        solved = replace(solved, warnings=(*solved.warnings, f"left out, as they show no tag: {', '.join(blind)}"))
    ply = root / "corners.ply"
    save_points(ply, np.concatenate([layout.corners()[n] for n in solved.tags]))
    names = tuple(files[name].name for name in solved.poses)
    return Posed(root, names, (lens,) * len(names), np.stack(list(solved.poses.values())), ply, solved.describe(layout))


def _known(tags, layout: TagLayout) -> dict[int, np.ndarray]:
    return {n: corners for n, corners in tags.items() if n in layout.base_from_tag}


def _upright(name: str, path: Path, root: Path) -> Path:
    """The photograph in ``root``, turned as its EXIF says."""
    root.mkdir(parents=True, exist_ok=True)
    if is_rotated(path):
        target = root / f"{name}.png"
        save_image(target, load_image(path))
    else:
        target = root / f"{name}{path.suffix}"
        target.unlink(missing_ok=True)
        target.symlink_to(path.absolute())
    return target


def _exif_focal(photographs, width: int, height: int) -> float | None:
    """The focal length [px] that the photographs' EXIF tells (the median), None if none does."""
    lengths = []
    for path in photographs:
        with Image.open(path) as image:
            told = image.getexif().get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
        if told and float(told) > 0:
            lengths.append(float(told) / FULL_FRAME_DIAGONAL * np.hypot(width, height))
    return float(np.median(lengths)) if lengths else None


def _lens(file: str | Path | None, width: int, height: int) -> dict | None:
    """COLMAP's lens of a camera file, at the size of the photographs; None without a file."""
    if file is None:
        return None
    said = parse_json(file, "camera file", dict)
    if abs(said.get("w", 0) * height - said.get("h", 0) * width) > max(width, height):
        raise ValueError(f"{file} is of pictures of {said.get('w')}x{said.get('h')}, these are {width}x{height}")
    scale = width / said["w"]
    scaled = {key: scale * said[key] for key in ("fl_x", "fl_y", "cx", "cy") if key in said}
    lens = lens_of(said | scaled | {"w": width, "h": height}, str(file))
    if lens["model"] == "OPENCV_FISHEYE":
        raise ValueError(f"{file}: a fisheye lens is not read here; undistort the photographs first")
    return lens


def _matrix(lens: dict) -> np.ndarray:
    fx, fy, cx, cy = lens["params"][:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _straightened(corners, lens: dict | None) -> np.ndarray:
    """Corners (4, 2) [px] as a pinhole of the same focal length and centre would show them."""
    bend = lens["params"][4:9] if lens else []
    if not any(bend):
        return corners
    import cv2

    K = _matrix(lens)
    return cv2.undistortPoints(corners[:, None], K, np.array(bend), P=K)[:, 0]
