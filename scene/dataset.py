"""Photographs and capture folders: what scene reads and writes on disk.

A capture folder holds one scene in nerfstudio's convention, so that nerfstudio opens it unchanged:

    <folder>/transforms.json      w, h, fl_x, fl_y, cx, cy [px]; frames of file_path and transform_matrix
             images/*.png         undistorted pinhole pictures
             colmap/masks/*.png   black where they are not to be looked at (``mask_path``), if that was said
             sparse.ply           points with colours (``ply_file_path``)

``transform_matrix`` is world_from_camera with OpenGL axes (x right, y up, z back); here cameras have OpenCV's.
Pixels: nerfstudio and instant-ngp send the ray of pixel column i through (i + 0.5 - cx) / fl_x and take cx, cy from
COLMAP as they are, so cx, cy mean the same here, there and in COLMAP, and nothing is added or taken away.

What nerfstudio has no word for stands under the key "scene2skill", which it ignores: the frame (its name, "robot base",
"level" or "arbitrary", its unit, what it rests on and how well it is known: scene.frame) and ``world_from_original``, the similarity from the
reconstruction's own frame.
"""

import json
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageOps

from scene.camera import OPENCV_FROM_OPENGL, Camera, View
from scene.files import read_json, replacing

EXTENSIONS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
MASKS = "colmap/masks"
INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy")
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
FEWEST_PHOTOGRAPHS = 3


def load_image(path: str | Path) -> np.ndarray:
    """A picture (H, W, 3) uint8 RGB, turned upright as its EXIF says. ValueError when unreadable or truncated."""
    path = Path(path)
    try:
        with Image.open(path) as image:
            image.load()  # Pillow refuses a truncated file here; OpenCV would return it half grey
            return np.array(ImageOps.exif_transpose(image).convert("RGB"))
    except FileNotFoundError:
        raise FileNotFoundError(f"no such picture: {path}") from None
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        raise ValueError(f"unreadable or truncated picture {path}: {error}; copy it again or take it away") from error


def read_mask(path: str | Path) -> np.ndarray:
    """A mask (H, W) bool, False where it is black. ValueError when unreadable."""
    return load_image(path).max(axis=2) > 127


def is_rotated(path: str | Path) -> bool:
    """Whether the EXIF of a picture asks for it to be turned or mirrored."""
    with Image.open(path) as image:
        return image.getexif().get(ExifTags.Base.Orientation, 1) not in (0, 1)


def save_image(path: str | Path, image: np.ndarray):
    """Write (H, W, 3) uint8 RGB, losslessly as PNG or (by the name) as JPEG of high quality, whole or not at all."""
    path = Path(path)
    with replacing(path) as temporary:
        if path.suffix.lower() in (".jpg", ".jpeg"):
            Image.fromarray(image).save(temporary, "JPEG", quality=98, subsampling=0)
        else:
            Image.fromarray(image).save(temporary, "PNG", compress_level=3)


def save_mask(path: str | Path, mask: np.ndarray):
    """Write (H, W) bool as a PNG of one channel, black where it is False, whole or not at all."""
    with replacing(path) as temporary:
        Image.fromarray(mask.astype(np.uint8) * 255).save(temporary, "PNG")


def load_views(folder: str | Path) -> list[View]:
    """The posed pictures of a capture folder, in the order of its transforms.json and in its frame."""
    folder = Path(folder)
    meta = load_transforms(folder / "transforms.json")
    views = [_view(folder, meta, frame, i) for i, frame in enumerate(meta["frames"])]
    twice = [name for name, count in Counter(v.name for v in views).items() if count > 1]
    if twice:
        raise ValueError(f"{folder / 'transforms.json'}: more than one frame is called {', '.join(twice[:6])}")
    return views


def load_frame(folder: str | Path) -> dict:
    """What transforms.json says of its frame: at least name and unit, "arbitrary" where it is silent.

    ``world_from_original`` (a list of 4 lists) is the similarity from the reconstruction's own frame, if there is one.
    """
    extra = load_transforms(Path(folder) / "transforms.json").get("scene2skill") or {}
    return {"name": "arbitrary", "unit": "arbitrary"} | extra.get("frame", {}) | {
        key: extra[key] for key in ("world_from_original",) if key in extra
    }


def load_transforms(path: Path) -> dict:
    """What a transforms.json says. Raises FileNotFoundError, or ValueError if it is not JSON or has no frames."""
    meta = read_json(path, f"no {path.name} in {path.parent}: reconstruct its photographs first")
    frames = meta.get("frames") if isinstance(meta, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise ValueError(f"{path}: the key frames must hold a list of at least one frame")
    return meta


def load_cameras(folder: str | Path) -> dict[Path, Camera]:
    """The cameras of a capture folder by the paths of their pictures, which are not opened."""
    folder = Path(folder)
    meta = load_transforms(folder / "transforms.json")
    return dict(_posed(folder, meta, frame, i) for i, frame in enumerate(meta["frames"]))


def _view(folder: Path, meta: dict, frame: dict, index: int) -> View:
    path, camera = _posed(folder, meta, frame, index)
    image = load_image(path)
    if image.shape[:2] != (camera.height, camera.width):
        size, said = f"{image.shape[1]}x{image.shape[0]}", f"{camera.width}x{camera.height}"
        raise ValueError(f"{_where(folder, frame, index)}: the picture is {size}, but w, h say {said}")
    mask = read_mask(inside(folder, frame["mask_path"], _where(folder, frame, index))) if frame.get("mask_path") else None
    if mask is not None and mask.shape != image.shape[:2]:
        said = f"{camera.width}x{camera.height}"
        raise ValueError(f"{_where(folder, frame, index)}: its mask is {mask.shape[1]}x{mask.shape[0]}, the picture {said}")
    return View(path.stem, camera, image, mask)


def _where(folder: Path, frame: dict, index: int) -> str:
    return f"{folder / 'transforms.json'}, frame {index} ({frame['file_path']})"


def _posed(folder: Path, meta: dict, frame: dict, index: int) -> tuple[Path, Camera]:
    """One frame of transforms.json; its own intrinsics go before those of the whole file."""
    missing = [key for key in ("file_path", "transform_matrix") if key not in frame]
    missing += [key for key in INTRINSICS if key not in frame and key not in meta]
    if missing:
        raise ValueError(f"{folder / 'transforms.json'}, frame {index}: missing {', '.join(missing)}")
    where = _where(folder, frame, index)
    lens = {key: frame.get(key, meta.get(key)) for key in INTRINSICS + DISTORTION}
    if any(lens[key] for key in DISTORTION):
        bent = ", ".join(f"{key} {lens[key]}" for key in DISTORTION if lens[key])
        raise ValueError(f"{where}: lens distortion ({bent}) is not read; reconstruct from the photographs instead")
    camera = _camera(lens, frame["transform_matrix"], where)
    return inside(folder, frame["file_path"], where), camera


def _camera(lens: dict, matrix, where: str) -> Camera:
    try:
        pose = np.array(matrix, dtype=float)
        if pose.shape != (4, 4) or not np.allclose(pose[3], [0, 0, 0, 1]):
            raise ValueError("transform_matrix must be (4, 4) with 0 0 0 1 as its last row")
        K = np.array([[lens["fl_x"], 0, lens["cx"]], [0, lens["fl_y"], lens["cy"]], [0, 0, 1]], dtype=float)
        if not (min(lens[key] for key in ("w", "h", "fl_x", "fl_y")) > 0):
            raise ValueError("w, h, fl_x, fl_y must be positive")
        return Camera(K, pose @ OPENCV_FROM_OPENGL, lens["w"], lens["h"])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from error


def inside(folder: Path, file_path, where: str) -> Path:
    """The path of a file that must lie in the capture folder."""
    root = os.path.abspath(folder)
    path = os.path.normpath(os.path.join(root, str(file_path)))
    if os.path.commonpath([root, path]) != root:
        raise ValueError(f"{where}: {file_path} lies outside the capture folder; paths must be relative to it")
    if not os.path.isfile(path):
        raise FileNotFoundError(f"{where}: no such file: {file_path}")
    return Path(path)


def save_views(
    folder: str | Path,
    views: Sequence[View],
    *,
    images: str = "images",
    points: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    frame: dict | None = None,
    original: np.ndarray | None = None,
):
    """Write a capture folder: pictures, then sparse.ply, and transforms.json last, so that a killed job leaves none.

    images: name of the pictures' folder inside ``folder``; a picture that is there already, pixel for pixel, is kept.
    points: (N, 3) in the views' frame [m]; colours: (N, 3) uint8.
    frame: what is known of the frame, such as {"name": "robot base", "unit": "m", "residual_mm": 0.8}.
    original: world_from_original (4, 4), the similarity that brought the reconstruction's own frame here.
    """
    folder = Path(folder)
    if not views:
        raise ValueError(f"no views to save to {folder}")
    files = [f"{images}/{_save_picture(folder / images, view).name}" for view in views]
    cameras = {file: view.camera for file, view in zip(files, views, strict=True)}
    masks = {file: f"{MASKS}/{view.name}.png" for file, view in zip(files, views, strict=True) if view.mask is not None}
    for view in views:
        if view.mask is not None:
            save_mask(folder / MASKS / f"{view.name}.png", view.mask)
    if points is not None:
        save_points(folder / "sparse.ply", points, colours)
    ply = "sparse.ply" if points is not None else None
    save_cameras(folder, cameras, ply=ply, frame=frame, original=original, masks=masks)


def save_cameras(
    folder: str | Path,
    cameras: dict[str, Camera],
    *,
    ply: str | None = None,
    frame: dict | None = None,
    original: np.ndarray | None = None,
    masks: dict[str, str] | None = None,
):
    """Write transforms.json alone: the cameras of pictures, which are named relative to ``folder``, as are their masks. See
    ``save_views``."""
    shared = _intrinsics(next(iter(cameras.values())))
    frames = []
    for file, camera in cameras.items():
        own = _intrinsics(camera)
        pose = (camera.world_from_camera @ OPENCV_FROM_OPENGL).tolist()
        masked = {"mask_path": masks[file]} if masks and file in masks else {}
        frames.append({"file_path": file, "transform_matrix": pose} | masked | (own if own != shared else {}))
    # without applied_transform nerfstudio takes a folder with colmap/sparse/0 for one whose axes were exchanged
    meta = {"camera_model": "OPENCV", **shared, "applied_transform": np.eye(4)[:3].tolist(), "frames": frames}
    if ply is not None:
        meta["ply_file_path"] = ply
    meta["scene2skill"] = {"version": 1, "frame": {"name": "arbitrary", "unit": "arbitrary"} | (frame or {})}
    if original is not None:
        meta["scene2skill"]["world_from_original"] = np.asarray(original, dtype=float).tolist()
    with replacing(Path(folder) / "transforms.json") as temporary:
        temporary.write_text(json.dumps(meta, indent=1, allow_nan=False), encoding="utf-8")


def _intrinsics(camera: Camera) -> dict:
    K = camera.K
    if K[0, 1] or K[1, 0] or (K[2] != [0, 0, 1]).any():
        raise ValueError("transforms.json holds no skewed camera")
    values = camera.width, camera.height, *(K[i, j].item() for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return dict(zip(INTRINSICS, values, strict=True))


def _save_picture(folder: Path, view: View) -> Path:
    for path in (folder / f"{view.name}{suffix}" for suffix in (".png", ".jpg", ".JPG", ".jpeg")):
        if path.is_file() and not is_rotated(path) and np.array_equal(load_image(path), view.image):
            return path
    path = folder / f"{view.name}.png"
    save_image(path, view.image)
    return path


def load_points(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """The sparse points of a capture folder: positions (N, 3) in its frame and colours (N, 3) uint8."""
    folder = Path(folder)
    named = load_transforms(folder / "transforms.json").get("ply_file_path", "sparse.ply")
    return read_points(inside(folder, named, f"sparse points of {folder}"))


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and colours (N, 3) uint8, grey where there are none, of a ply file; ValueError if it is none."""
    import trimesh

    if b"element vertex 0\n" in path.read_bytes()[:1000]:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    try:
        cloud = trimesh.load(path, file_type="ply", process=False)
        points = np.array(cloud.vertices, dtype=float).reshape(-1, 3)
    except Exception as error:  # a parser of foreign files may fail in any way
        raise ValueError(f"{path} is not a readable ply file: {error}") from error
    colours = np.asarray(getattr(cloud, "colors", ()), dtype=np.uint8)
    has_colours = colours.ndim == 2 and len(colours) == len(points)
    return points, np.ascontiguousarray(colours[:, :3]) if has_colours else np.full(points.shape, 128, np.uint8)


def save_points(path: str | Path, points: np.ndarray, colours: np.ndarray | None = None):
    """Write (N, 3) points with (N, 3) uint8 colours (grey if none) as binary little-endian ply, in double precision."""
    points = np.asarray(points, dtype=float)
    rows = np.empty(len(points), dtype=[("position", "<f8", 3), ("colour", "u1", 3)])
    rows["position"] = points
    rows["colour"] = 128 if colours is None else colours
    properties = [f"property double {axis}" for axis in "xyz"]
    properties += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties, "end_header", ""]
    with replacing(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + rows.tobytes())
