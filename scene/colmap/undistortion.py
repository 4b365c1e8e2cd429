"""A model's pictures as pinholes see them, and model.npz: what scene.colmap.Model loads. Runs in COLMAP's process."""

import shutil
from pathlib import Path

import numpy as np

from scene.album import flat
from scene.camera import Camera, invert
from scene.colmap.lens import pinhole, through_lens, widest_pinhole
from scene.dataset import MASKS, load_image, read_mask, save_image, save_mask
from scene.files import replacing


def write_results(model, folder, names, max_size, straight, say, masks, photographs=None):
    """The undistorted pictures and masks ({picture's name: file}), and model.npz. straight: numbers of the cameras that are
    pinholes. photographs: where they lie, if not in ``folder``."""
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    lenses = {n: pinhole(camera) if n in straight else widest_pinhole(camera) for n, camera in model.cameras.items()}
    cameras, files = [], []
    say(stage="pictures", count=0)
    for image in images:
        lens = model.cameras[image.camera_id]
        bent = None if image.camera_id in straight else lens
        full = Camera(lenses[image.camera_id], _world_from_camera(image), lens.width, lens.height)
        scale = min(1, max_size / max(full.width, full.height))
        cameras.append(full.resized(round(full.width * scale), round(full.height * scale)))
        source = (photographs or folder / "photographs") / image.name
        target = folder / "images" / flat(image.name)
        files.append(_undistort(source, target, bent, full, cameras[-1]))
        if image.name in masks:
            mask = np.uint8(255) * read_mask(masks[image.name])
            seen = _resampled(mask, bent, full, cameras[-1]) > 250  # what is partly ignored is ignored
            save_mask(folder / MASKS / f"{flat(image.name)}.png", seen)
        say(count=len(files))
    points = [model.points3D[number] for number in sorted(model.points3D)]
    registered = {image.name for image in images}
    with replacing(folder / "colmap" / "model.npz") as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            names=[flat(image.name) for image in images],
            images=[path.name for path in files],
            K=[camera.K for camera in cameras],
            world_from_camera=[camera.world_from_camera for camera in cameras],
            sizes=[(camera.width, camera.height) for camera in cameras],
            points=np.array([p.xyz for p in points]).reshape(-1, 3),
            colours=np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
            point_errors=[p.error for p in points],
            total=len(names),
            reprojection_px=model.compute_mean_reprojection_error() if model.compute_num_observations() else np.nan,
            unregistered=np.array([flat(name) for name in names if name not in registered], dtype=str),
        )


def _world_from_camera(image) -> np.ndarray:
    camera_from_world = np.eye(4)
    camera_from_world[:3] = image.cam_from_world().matrix()
    return invert(camera_from_world)


def _undistort(source, stem, lens, full, camera) -> Path:
    """Write one picture as ``camera`` sees it to ``stem`` with an ending; without a change it is copied bit by bit."""
    unchanged = lens is None and (full.width, full.height) == (camera.width, camera.height)
    if unchanged and source.suffix.lower() in (".png", ".jpg", ".jpeg"):
        stem.parent.mkdir(exist_ok=True)
        return Path(shutil.copyfile(source, stem.with_name(stem.name + source.suffix)))
    target = stem.with_name(f"{stem.name}.png")
    save_image(target, _resampled(load_image(source), lens, full, camera))
    return target


def _resampled(picture, lens, full, camera) -> np.ndarray:
    """A picture (H, W[, 3]) uint8 of a lens (None: a pinhole) as ``camera`` sees it."""
    import cv2

    picture = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    if lens is not None:
        enlarged = np.array([full.width / camera.width, full.height / camera.height])
        seen = through_lens(lens, full.K, camera.pixel_centres().reshape(-1, 2) * enlarged)
        seen = seen / enlarged - 0.5  # OpenCV: centres at whole numbers
        seen = seen.reshape(camera.height, camera.width, 2).astype(np.float32)
        picture = cv2.remap(picture, seen[..., 0], seen[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return picture
