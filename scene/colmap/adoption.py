"""Cameras that are known already become a COLMAP model as they are. Runs in COLMAP's process, see scene.colmap."""

import json
from pathlib import Path

import numpy as np

from scene.album import flat
from scene.camera import invert
from scene.colmap.lens import STRAIGHT, bend
from scene.colmap.undistortion import write_results
from scene.dataset import inside, is_rotated, load_image
from scene.model import ReconstructionFailed

PANORAMAS = ("EQUIRECTANGULAR",)


def adopt(pycolmap, folder, names, images, max_size, fewest, say, sparse=None, masks=None, **given):
    """Write what is known already as ``solve`` writes what it has found."""
    folder, images = Path(folder), Path(images)
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    if sparse is None:
        model = _built(pycolmap, names, **given)
    else:
        try:
            model = pycolmap.Reconstruction(sparse)
        except (ValueError, RuntimeError, MemoryError, IndexError, KeyError) as error:
            raise ReconstructionFailed(f"{sparse} is not a readable COLMAP model: {error}") from error
    _check_lenses(model)
    posed = [image for image in model.images.values() if image.has_pose]
    if len(posed) < fewest:
        raise ReconstructionFailed(f"only {len(posed)} pictures have cameras; a scene needs {fewest}, better 30")
    _check_pictures(images, [(image.name, model.cameras[image.camera_id]) for image in posed])
    (folder / "colmap" / "sparse" / "0").mkdir(parents=True)
    model.write(folder / "colmap" / "sparse" / "0")
    straight = {n for n, camera in model.cameras.items() if bend(camera, max_size) < STRAIGHT}
    masks = {name: Path(path) for name, path in (masks or {}).items()}
    write_results(model, folder, [image.name for image in model.images.values()], max_size, straight, say, masks, images)


def _built(pycolmap, names, lenses, poses, points, colours):
    """A COLMAP model of cameras and points alone; pictures of one lens share its camera."""
    model, numbers = pycolmap.Reconstruction(), {}
    for i, (name, lens, pose) in enumerate(zip(names, lenses, poses, strict=True), start=1):
        key = json.dumps(lens)
        if key not in numbers:
            numbers[key] = len(numbers) + 1
            model.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=numbers[key], **lens))
        image = pycolmap.Image(name=name, camera_id=numbers[key], image_id=i)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(invert(np.array(pose))[:3]))
    for point, colour in zip(points, colours, strict=True):
        model.add_point3D(np.array(point), pycolmap.Track(), np.array(colour, dtype=np.uint8))
    return model


def _check_lenses(model):
    """Every lens can become a pinhole: a panorama cannot, and COLMAP would crash over it."""
    panoramas = sorted({camera.model.name for camera in model.cameras.values()} & set(PANORAMAS))
    if panoramas:
        raise ReconstructionFailed(
            f"cameras of model {panoramas[0]} see all around, which no pinhole does: cut their pictures into flat ones"
        )


def _check_pictures(images: Path, cameras: list[tuple]):
    """Every picture is there, and the one that its camera took."""
    for name, camera in cameras:
        try:
            path = inside(images, name, f"picture {name}")
            height, width = load_image(path).shape[:2]
        except (ValueError, FileNotFoundError) as error:
            raise ReconstructionFailed(str(error)) from error
        if is_rotated(path):
            raise ReconstructionFailed(f"picture {name} is turned by its EXIF, its camera may not be: save it upright")
        if (width, height) != (camera.width, camera.height):
            said = f"{camera.width}x{camera.height}"
            raise ReconstructionFailed(f"picture {name} is {width}x{height}, but its camera says {said}")
    called = [flat(name) for name, _ in cameras]
    if len(set(called)) < len(called):
        twice = sorted({name for name in called if called.count(name) > 1})
        raise ReconstructionFailed(f"more than one picture is called {', '.join(twice[:6])}")
