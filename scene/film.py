"""A camera path becomes pictures, depth and a video, in a folder that goes on where a killed job stopped.

    <folder>/<name>.png  <name>_depth.npy     picture; depth, and how sure it is, as scene.views has them
             <name>_confidence.png
             <name>_depth.png                 if asked: depth in 16 bits, in millimetres, 0 where nothing is hit
             transforms.json                  the cameras (nerfstudio's), written when all pictures are there
             planned.json                     what the pictures are of: those of another path or field are made anew
"""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from scene.camera import Camera
from scene.dataset import load_image, save_cameras
from scene.files import replacing
from scene.paths import CameraPath
from scene.views import depth_path, is_whole, render


def film(
    field,
    path: CameraPath,
    folder: str | Path,
    *,
    identity: str,
    save_video: Callable | None = None,
    width: int | None = None,
    height: int | None = None,
    fov_deg: float | None = None,
    near: float = 0.0,
    far: float | None = None,
    fps: float | None = None,
    depth: bool = True,
    depth_png: bool = False,
    only_missing: bool = True,
    frame: dict | None = None,
    progress: Callable = iter,
) -> dict[str, int]:
    """Render ``path`` into ``folder``, see above; says how many "frames" it has and how many were "rendered" now.

    identity: names the field, so that pictures of an earlier one are not kept. width, height [px], fov_deg (horizontal)
    [deg]: None is what the path's cameras have. near, far: only what lies between them is seen [m along z].
    fps: None is the path's own, or 24. only_missing: keep pictures that the same camera took of the same field.
    save_video(file, pictures, fps) writes ``<folder>.mp4``. frame: as in scene.dataset.save_views.
    """
    _refuse_words(width=width, height=height, fov_deg=fov_deg, near=near, far=far, fps=fps)
    if near < 0 or (far is not None and far <= near):
        raise ValueError(f"near must not be negative and far must lie beyond it, not {near} and {far}")
    fps = fps or path.fps or 24.0
    if fps <= 0:
        raise ValueError(f"a video needs a positive number of frames a second, not {fps}")
    folder = Path(folder)
    cameras = {name: shaped(camera, width, height, fov_deg) for name, camera in path.cameras.items()}
    far = float("inf") if far is None else far
    planned = {name: [identity, near, far, *_plain(camera)] for name, camera in cameras.items()}
    _clear(folder, planned if only_missing else {})
    with replacing(folder / "planned.json") as temporary:
        temporary.write_text(json.dumps(planned), encoding="utf-8")
    rendered = 0
    for name, camera in progress(cameras.items()):
        rendered += not is_whole(folder, name, depth)
        render(field, {name: camera}, folder, depth=depth, near=near, far=far)
        if depth and depth_png:
            save_depth_png(folder / f"{name}_depth.png", np.load(depth_path(folder, name), allow_pickle=False))
    save_cameras(folder, {f"{name}.png": camera for name, camera in cameras.items()}, frame=frame)
    if save_video is not None:
        save_video(folder.with_name(f"{folder.name}.mp4"), Pictures([folder / f"{name}.png" for name in cameras]), fps)
    return {"frames": len(cameras), "rendered": rendered}


def _refuse_words(**settings):
    """Raise ValueError for what is neither a number nor None."""
    for name, value in settings.items():
        if value is not None and not isinstance(value, (int, float)):
            raise ValueError(f"{name} must be a number, not {value!r}")


class Pictures(Sequence):
    """Pictures in files, read one at a time: a long video does not fit into memory."""

    def __init__(self, files: Sequence[Path]):
        self.files = files

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> np.ndarray:
        return load_image(self.files[index])

    def __iter__(self) -> Iterator[np.ndarray]:
        return map(load_image, self.files)


def shaped(camera: Camera, width: int | None = None, height: int | None = None, fov_deg: float | None = None) -> Camera:
    """The camera with another size and horizontal field of view; of one side alone, the other keeps its proportion."""
    if width is None and height is None:
        width, height = camera.width, camera.height
    elif width is None:
        width = round(height * camera.width / camera.height)
    elif height is None:
        height = round(width * camera.height / camera.width)
    if not (0 < width <= 16384 and 0 < height <= 16384):
        raise ValueError(f"a picture of {width} x {height} pixels cannot be rendered")
    if fov_deg is not None:
        if not 0 < fov_deg < 180:
            raise ValueError(f"a field of view lies between 0 and 180 degrees, not at {fov_deg}")
        return Camera.from_fov(camera.world_from_camera, width, height, fov_deg)
    return camera if (width, height) == (camera.width, camera.height) else camera.cropped(width, height)


def save_depth_png(path: str | Path, metres: np.ndarray):
    """Write depth (h, w) [m] as 16-bit PNG in millimetres; 0 where nothing is hit or it is beyond 65.535 m."""
    millimetres = np.nan_to_num(np.round(1000 * np.asarray(metres, dtype=float)), nan=0, posinf=0, neginf=0)
    with replacing(path) as temporary:
        Image.fromarray(np.where(millimetres <= 65535, millimetres, 0).astype(np.uint16)).save(temporary, "PNG")


def _clear(folder: Path, planned: dict):
    """Take away what is not of this plan: pictures of other cameras, and the list of cameras until it is true again."""
    (folder / "transforms.json").unlink(missing_ok=True)
    try:
        earlier = json.loads((folder / "planned.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        earlier = {}
    for name in earlier if isinstance(earlier, dict) else ():
        if earlier[name] != planned.get(name):
            for ending in (".png", "_depth.npy", "_depth.png", "_confidence.png"):
                (folder / f"{Path(name).name}{ending}").unlink(missing_ok=True)


def _plain(camera: Camera) -> list:
    return [camera.K.tolist(), camera.world_from_camera.tolist(), camera.width, camera.height]
