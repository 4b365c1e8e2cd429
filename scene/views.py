"""New views of a scene: which cameras, and their pictures on disk.

    <folder>/<name>.png              picture
             <name>_depth.npy        float32 [m along the optical axis], nan where nothing is hit
             <name>_confidence.png   8 bits, 0 to 255 for 0 to 1: how sure that depth is (scene.surface.depth)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from scene import paths
from scene.camera import Camera, View, look_at
from scene.dataset import load_cameras, load_image, save_image
from scene.files import replacing


@dataclass(frozen=True)
class Chosen:
    """Named cameras: those to sketch on (a third for evaluation), those of an orbit; and why these, in sentences."""

    sketch: dict[str, Camera]
    orbit: dict[str, Camera]
    why: tuple[str, ...] = ()


def choose(
    photographed: list[Camera],
    eyes: list[dict] | None = None,
    *,
    field=None,
    workspace=None,
    suggest: Callable | None = None,
    sketch: Sequence = (),
    width=640,
    height=480,
    orbit=12,
) -> Chosen:
    """Views of size ``width`` x ``height`` at ``eyes`` (see ``given``), or at photographed viewpoints where there are none.

    suggest: as `scene.viewpoints.suggest`, chooses instead, by ``field`` and ``workspace``: a pair and a third view, or
    the one after those of ``sketch`` (each with view, camera and motions). orbit: number of frames of an orbit at half
    that size.
    """
    size, why = {"width": width, "height": height}, ()
    if suggest is not None:
        named, why = suggested(partial(suggest, photographed, field=field, workspace=workspace, **size), sketch)
    else:
        named = numbered(given(eyes, **size) if eyes else well_separated(photographed, **size))
    around = paths.orbit(photographed, frames=orbit).cameras if orbit else {}
    return Chosen(named, {name: camera.cropped(width // 2, height // 2) for name, camera in around.items()}, why)


def around(
    photographed: list[Camera],
    eyes: list[dict] | None = None,
    *,
    count=2,
    span_deg=60.0,
    elevation_deg=35.0,
    radius=1.6,
    fov_deg=50.0,
    width=640,
    height=480,
    field=None,
    workspace=None,
    orbit=0,
) -> Chosen:
    """``count`` views at one height, evenly over ``span_deg`` of a circle of ``radius`` [m] about what the first of ``eyes`` look at.

    In the middle stands who looks from between the first two of them. field, workspace and orbit are not asked.
    """
    if not eyes or len(eyes) < 2:
        raise ValueError("views around a world need its sketch_views, two of them: use scene/views=default")
    target = np.mean([view["target"] for view in eyes[:2]], axis=0)
    towards = np.mean([view["eye"] for view in eyes[:2]], axis=0) - target
    azimuth = np.arctan2(towards[1], towards[0]) + np.radians(np.linspace(-span_deg / 2, span_deg / 2, count))
    flat, up = radius * np.cos(np.radians(elevation_deg)), radius * np.sin(np.radians(elevation_deg))
    ring = target + np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.full(count, up)], axis=1)
    return Chosen(numbered(given([{"eye": eye, "target": target, "fov_deg": fov_deg} for eye in ring], width=width, height=height)), {})


def suggested(suggest: Callable, sketch: Sequence) -> tuple[dict[str, Camera], tuple[str, ...]]:
    """Named cameras and why: the pair that ``suggest`` proposes and the view after it; or sketched views and the next."""
    if not sketch:
        pair = suggest()
        third = suggest(pair.cameras)
        return numbered([*pair.cameras, *third.cameras]), (pair.why, third.why)
    drawn = {one.view: one.camera for one in sketch}
    strokes = [one.motions[0].points for one in sketch]
    found = suggest(list(drawn.values()), strokes)
    number = next(i for i in count(len(drawn) + 1) if f"view{i}" not in drawn)
    return drawn | {f"view{number}": found.cameras[0]}, (found.why,)


def numbered(cameras: Sequence[Camera]) -> dict[str, Camera]:
    """Cameras named view1, view2, ..."""
    return {f"view{i}": camera for i, camera in enumerate(cameras, start=1)}


def well_separated(cameras: list[Camera], *, width=640, height=480, angle_deg=75.0) -> list[Camera]:
    """Three of the photographs' viewpoints to sketch on: two about ``angle_deg`` apart, and one far from both.

    Angles are seen from the photographs' focus. They are photographed viewpoints since a field is sharpest there.
    """
    offsets = np.stack([c.centre for c in cameras]) - paths.focus(cameras)
    directions = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    first, second = np.unravel_index(np.argmin(np.abs(angles - angle_deg)), angles.shape)
    third = int(np.argmax(np.minimum(angles[first], angles[second])))
    return [cameras[i].cropped(width, height) for i in (first, second, third)]


def given(eyes: list[dict], *, width=640, height=480) -> list[Camera]:
    """Cameras from {eye (3,), target (3,) [m], fov_deg} records, as a world's file has them."""
    return [Camera.from_fov(look_at(v["eye"], v["target"]), width, height, v["fov_deg"]) for v in eyes]


def render(
    field, cameras: dict[str, Camera], folder: Path, progress=None, *, depth: bool = True, **limits
) -> list[View]:
    """Render every named camera: its picture and, with ``depth``, depth and confidence beside it, see above.

    What is already there whole is read, not rendered: a killed job goes on. limits: near and far of ``Field.render``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    views = []
    for name, camera in (progress or iter)(cameras.items()):
        picture = folder / f"{name}.png"
        if not is_whole(folder, name, depth):
            image, metres = field.render(camera, **limits)
            if depth:
                from scene.surface.depth import confidence

                save_depth(folder, name, metres, confidence(field, camera, metres))
            save_image(picture, image)
        views.append(View(name, camera, load_image(picture)))
    return views


def is_whole(folder: Path, name: str, depth: bool = True) -> bool:
    """Whether a named view lies in ``folder``, with what belongs beside it."""
    beside = (depth_path(folder, name), confidence_path(folder, name)) if depth else ()
    return all(path.is_file() for path in (Path(folder) / f"{name}.png", *beside))


def save_depth(folder: Path, name: str, metres: np.ndarray, confidence: np.ndarray):
    """Write a view's depth (h, w) [m along the optical axis, nan: nothing is hit], its confidence (h, w) in [0, 1]."""
    with replacing(depth_path(folder, name)) as temporary:
        np.save(temporary, metres.astype(np.float32))
    grey = np.round(255 * np.clip(confidence, 0, 1)).astype(np.uint8)
    save_image(confidence_path(folder, name), grey)


def load_depths(folder: Path, cameras: dict[str, Camera], sure: float = 0.0) -> dict[str, np.ndarray]:
    """Depth pictures (h, w) float32 [m along the optical axis] of named views in ``folder``, by name; nan where nothing
    is hit, or with less confidence than ``sure``. Of a field that learned long, depth of less than 0.3 is mostly wrong (on the embedded
    table, 0.08 % of what is seen); one that learned for seconds has less nearly everywhere, though its depth is right in the median.

    Those that were rendered by a camera like the named one: a photograph of that name stands elsewhere. Depth without a
    confidence beside it counts as sure.
    """
    folder, same = Path(folder), _rendered(folder, cameras)
    depths = {name: np.load(path, allow_pickle=False) for name in same if (path := depth_path(folder, name)).is_file()}
    known = load_confidences(folder, {name: cameras[name] for name in depths})
    return {name: _sure(d, known[name], sure, folder / name) if name in known else d for name, d in depths.items()}


def load_confidences(folder: Path, cameras: dict[str, Camera]) -> dict[str, np.ndarray]:
    """How sure the depth of ``load_depths`` is, (h, w) float32 in [0, 1], 0 where nothing is hit: 1 for a clean opaque
    surface, the share of light that comes from within 1 % of the depth."""
    paths = {name: confidence_path(folder, name) for name in _rendered(folder, cameras)}
    return {name: load_image(path)[..., 0].astype(np.float32) / 255 for name, path in paths.items() if path.is_file()}


def _sure(depth: np.ndarray, confidence: np.ndarray, least: float, view: Path) -> np.ndarray:
    """The depth that is as sure as asked, else nan."""
    if depth.shape != confidence.shape:
        sizes = f"depth of {depth.shape} and confidence of {confidence.shape}"
        raise ValueError(f"{view}: {sizes} are of different pictures; render the view again")
    return np.where(confidence >= least, depth, np.float32(np.nan))


def depth_path(folder: Path, name: str) -> Path:
    """Where the depth picture of a named view lies."""
    return Path(folder) / f"{name}_depth.npy"


def confidence_path(folder: Path, name: str) -> Path:
    """Where the confidence of that depth lies."""
    return Path(folder) / f"{name}_confidence.png"


def _rendered(folder: Path, cameras: dict[str, Camera]) -> list[str]:
    """Which of the named cameras took the picture of that name in ``folder``."""
    if not (Path(folder) / "transforms.json").is_file():
        return []
    there = {path.stem: camera for path, camera in load_cameras(folder).items()}
    return [name for name, camera in cameras.items() if name in there and _same_view(camera, there[name])]


def _same_view(a: Camera, b: Camera) -> bool:
    """Whether two cameras show the same picture, at whatever size."""
    a = a.resized(b.width, b.height)
    return np.allclose(a.K, b.K, atol=0.5) and np.allclose(a.world_from_camera, b.world_from_camera, atol=1e-4)
