"""New views of a scene: which cameras, and their pictures on disk."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scene.camera import Camera, View, look_at
from scene.camera import orbit as circle
from scene.dataset import load_image, load_views, save_image
from scene.files import replacing

MOST_GAP_DEG = 60.0  # an orbit does not cross an arc wider than this that nobody photographed


@dataclass(frozen=True)
class Chosen:
    """Named cameras: three views to sketch on (the third for evaluation), and those of an orbit."""

    sketch: dict[str, Camera]
    orbit: dict[str, Camera]


def choose(photographed: list[Camera], eyes: list[dict] | None = None, *, width=640, height=480, orbit=12) -> Chosen:
    """Views of size ``width`` x ``height`` at ``eyes`` (see ``given``), or at photographed viewpoints where none are given.

    orbit: number of frames of an orbit at half that size.
    """
    size = {"width": width, "height": height}
    sketch = given(eyes, **size) if eyes else well_separated(photographed, **size)
    around = orbit_path(photographed, frames=orbit, width=width // 2, height=height // 2) if orbit else []
    return Chosen(
        {f"view{i}": camera for i, camera in enumerate(sketch, start=1)},
        {f"{i:04d}": camera for i, camera in enumerate(around)},
    )


def focus(cameras: list[Camera]) -> np.ndarray:
    """The point (3,) that is nearest to all optical axes: what the photographs look at.

    Least squares over the axes: sum_i (I - d_i d_i^T) (x - o_i) = 0.
    """
    rejections = np.eye(3) - np.einsum("ni,nj->nij", *2 * [np.stack([c.forward for c in cameras])])
    centres = np.stack([c.centre for c in cameras])
    return np.linalg.lstsq(rejections.sum(0), np.einsum("nij,nj->i", rejections, centres), rcond=None)[0]


def well_separated(cameras: list[Camera], *, width=640, height=480, angle_deg=75.0) -> list[Camera]:
    """Three of the photographs' viewpoints to sketch on: two about ``angle_deg`` apart, and one far from both.

    Angles are seen from the photographs' focus. They are photographed viewpoints since a field is sharpest there.
    """
    offsets = np.stack([c.centre for c in cameras]) - focus(cameras)
    directions = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    first, second = np.unravel_index(np.argmin(np.abs(angles - angle_deg)), angles.shape)
    third = int(np.argmax(np.minimum(angles[first], angles[second])))
    return [_cropped(cameras[i], width, height) for i in (first, second, third)]


def orbit_path(cameras: list[Camera], *, frames=24, width=640, height=480) -> list[Camera]:
    """Cameras on a circle around the photographs' focus at their median distance and elevation.

    Where the photographs leave an arc wider than ``MOST_GAP_DEG`` unseen, the path swings over the seen arc.
    """
    target = focus(cameras)
    offsets = np.stack([c.centre for c in cameras]) - target
    radius = np.median(np.linalg.norm(offsets, axis=1))
    elevation = np.degrees(np.median(np.arcsin(offsets[:, 2] / np.linalg.norm(offsets, axis=1))))
    azimuths = np.sort(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])))
    gaps = np.diff(azimuths, append=azimuths[0] + 360)
    widest = int(np.argmax(gaps))
    if gaps[widest] <= MOST_GAP_DEG:
        poses = circle(target, radius, elevation, frames)
    else:
        sweep = 360 - gaps[widest]
        poses = circle(target, radius, elevation, frames, azimuths[(widest + 1) % len(azimuths)], sweep)
    middle = _cropped(cameras[0], width, height)
    return [Camera(middle.K, pose, width, height) for pose in poses]


def given(eyes: list[dict], *, width=640, height=480) -> list[Camera]:
    """Cameras from {eye (3,), target (3,) [m], fov_deg} records, as a world's file has them."""
    return [Camera.from_fov(look_at(v["eye"], v["target"]), width, height, v["fov_deg"]) for v in eyes]


def render(field, cameras: dict[str, Camera], folder: Path, progress=None, *, depth: bool = True) -> list[View]:
    """Render every named camera: ``<name>.png`` and, with ``depth``, ``<name>_depth.npy`` (see ``load_depths``).

    What is already there whole is read, not rendered: a killed job goes on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    views = []
    for name, camera in (progress or iter)(cameras.items()):
        picture, beside = folder / f"{name}.png", _depth_path(folder, name)
        if not (picture.exists() and (beside.exists() or not depth)):
            image, metres = field.render(camera)
            save_image(picture, image)
            if depth:
                with replacing(beside) as temporary:
                    np.save(temporary, metres.astype(np.float32))
        views.append(View(name, camera, load_image(picture)))
    return views


def load_depths(folder: Path, cameras: dict[str, Camera]) -> dict[str, np.ndarray]:
    """Depth pictures (h, w) float32 [m along the optical axis, nan where nothing is hit] of named views in ``folder``.

    Those that were rendered by a camera like the named one: a photograph of that name stands elsewhere.
    """
    if not (Path(folder) / "transforms.json").is_file():
        return {}
    rendered = {view.name: view.camera for view in load_views(folder)}
    same = [name for name, camera in cameras.items() if name in rendered and _same_view(camera, rendered[name])]
    paths = {name: _depth_path(folder, name) for name in same}
    return {name: np.load(path, allow_pickle=False) for name, path in paths.items() if path.is_file()}


def _depth_path(folder: Path, name: str) -> Path:
    return Path(folder) / f"{name}_depth.npy"


def _same_view(a: Camera, b: Camera) -> bool:
    """Whether two cameras show the same picture, at whatever size."""
    a = a.resized(b.width, b.height)
    return np.allclose(a.K, b.K, atol=0.5) and np.allclose(a.world_from_camera, b.world_from_camera, atol=1e-4)


def _cropped(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another picture size, its view cropped (never stretched) about the principal point."""
    scale = max(width / camera.width, height / camera.height)
    focal = camera.K[0, 0] * scale
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(K, camera.world_from_camera, width, height)
