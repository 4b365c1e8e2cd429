"""Camera paths in files: those of nerfstudio's viewer, and lists of poses in the scene's own frame.

    camera_path.json   {"camera_path": [{"camera_to_world": 16 numbers, "fov": 50, "aspect": 1.3}, ...],
                        "render_width": 640, "render_height": 480, "fps": 24}
                       camera_to_world by rows, with OpenGL axes (x right, y up, z back); fov is the vertical one [deg]
    poses              [[[4 x 4]], ...], or {"poses": [[[4 x 4]], ...]} with any of "names", "width", "height",
                       "fov_deg" (horizontal) and "fps": world_from_camera [m] with OpenCV axes
                       (x right, y down, z forward)

nerfstudio turns, moves and scales a scene before it trains; what it did stands in the dataparser_transforms.json that
it writes beside its own files. Where that lies beside the camera path, it is undone, else the frames are taken for the
same (train with ``--orientation-method none --center-method none --auto-scale-poses False``).
"""

import json
import math
import re
from pathlib import Path

import numpy as np

from scene.camera import OPENCV_FROM_OPENGL, Camera
from scene.files import read_json
from scene.paths import CameraPath


def read(path: str | Path, like: Camera) -> CameraPath:
    """The camera path of a JSON file; poses without intrinsics of their own are seen with those of ``like``.

    Raises FileNotFoundError or ValueError (not JSON, neither of the two kinds, missing keys, poses that are none).
    """
    path = Path(path)
    content = read_json(path, f"no such file of camera poses: {path}")
    if isinstance(content, list):
        content = {"poses": content}
    try:
        if isinstance(content, dict) and isinstance(content.get("camera_path"), list):
            return _of_nerfstudio(content, _dataparser(path.with_name("dataparser_transforms.json")))
        if isinstance(content, dict) and isinstance(content.get("poses"), list):
            return _of_poses(content, like)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        said = f"missing {error}" if isinstance(error, KeyError) else error
        raise ValueError(f"{path}: {said}") from error
    raise ValueError(f"{path} holds no camera path: wanted nerfstudio's camera_path, or a list of 4x4 poses")


def _of_nerfstudio(content: dict, saved_from_theirs) -> CameraPath:
    kind = str(content.get("camera_type", "perspective")).lower()
    if kind != "perspective":
        raise ValueError(f"a {kind} camera is not rendered, only a perspective one")
    width, height = _size(content["render_width"], content["render_height"])
    cameras = []
    for i, entry in enumerate(_filled(content["camera_path"])):
        focal = height / 2 / math.tan(math.radians(_angle(entry["fov"], f"frame {i}: fov")) / 2)
        pose = saved_from_theirs(_pose(entry["camera_to_world"], f"frame {i}")) @ OPENCV_FROM_OPENGL
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        cameras.append(_camera(K, pose, width, height, f"frame {i}"))
    return CameraPath({f"{i:04d}": camera for i, camera in enumerate(cameras)}, _rate(content))


def _of_poses(content: dict, like: Camera) -> CameraPath:
    poses = [_pose(pose, f"pose {i}") for i, pose in enumerate(_filled(content["poses"]))]
    names = _names(content.get("names", [f"{i:04d}" for i in range(len(poses))]), len(poses))
    width, height = _size(content.get("width", like.width), content.get("height", like.height))
    if "fov_deg" in content:
        K = Camera.from_fov(np.eye(4), width, height, _angle(content["fov_deg"], "fov_deg")).K
    else:
        K = like.cropped(width, height).K if (width, height) != (like.width, like.height) else like.K
    cameras = [_camera(K, pose, width, height, f"pose {i}") for i, pose in enumerate(poses)]
    return CameraPath(dict(zip(names, cameras, strict=True)), _rate(content))


def _dataparser(path: Path):
    """What brings a pose (4, 4) of nerfstudio's training frame to the frame of the transforms.json it had read."""
    if not path.is_file():
        return lambda pose: pose
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        theirs_from_saved = np.concatenate([np.array(content["transform"], dtype=float).reshape(3, 4), [[0, 0, 0, 1]]])
        scale = float(content["scale"])
        saved_from_theirs = np.linalg.inv(theirs_from_saved)
        if not (scale > 0 and np.isfinite(saved_from_theirs).all()):
            raise ValueError("scale must be positive")
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise ValueError(f"{path.name} beside it is not nerfstudio's: {error}") from error

    def undone(pose):
        unscaled = pose.copy()
        unscaled[:3, 3] /= scale
        return saved_from_theirs @ unscaled

    return undone


def _filled(entries: list) -> list:
    if not entries:
        raise ValueError("there is no pose in it")
    return entries


def _pose(numbers, where: str) -> np.ndarray:
    """A 4x4 matrix, flat or by rows."""
    try:
        pose = np.array(numbers, dtype=float)
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape not in ((16,), (4, 4)) or not np.allclose(pose.reshape(4, 4)[3], [0, 0, 0, 1]):
        raise ValueError(f"{where}: a pose is a 4x4 matrix of numbers by rows, with 0 0 0 1 as its last row")
    return pose.reshape(4, 4)


def _camera(K, pose, width: int, height: int, where: str) -> Camera:
    try:
        return Camera(K, pose, width, height)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _size(width, height) -> tuple[int, int]:
    if not all(isinstance(n, int | float) and n == int(n) and 0 < n <= 16384 for n in (width, height)):
        raise ValueError(f"a picture of {width} x {height} pixels cannot be rendered")
    return int(width), int(height)


def _angle(degrees, what: str) -> float:
    if not (isinstance(degrees, int | float) and 0 < degrees < 180):
        raise ValueError(f"{what} must lie between 0 and 180 degrees, not {degrees}")
    return float(degrees)


def _rate(content: dict) -> float | None:
    fps = content.get("fps")
    if fps is not None and not (isinstance(fps, int | float) and 0 < fps <= 1000):
        raise ValueError(f"fps must be positive, not {fps}")
    return fps


def _names(names, count: int) -> list[str]:
    """Names become those of files, so they are plain."""
    plain = isinstance(names, list) and all(isinstance(n, str) and re.fullmatch(r"\w[\w .-]*", n) for n in names)
    if not plain or len({n.lower() for n in names}) != count or len(names) != count:
        raise ValueError(f"names must be {count} different ones of letters, digits, blanks and . - _")
    return names
