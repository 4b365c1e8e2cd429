"""Photographs -> cameras and points, by COLMAP's incremental structure from motion.

pycolmap runs in a process of its own: importing it first spoils zlib, it holds the interpreter for seconds, and only
a process can be killed. What passes between the two is one JSON line in and files out:

    <work>/images/<name>         the photographs undistorted, at most ``max_size`` px long, as the cameras of Model see
           colmap/sparse/0/      the model with the lens as it was estimated, for COLMAP
           colmap/model.npz      the Model
           colmap/masks/         where the pictures are not to be looked at, for those that came with a mask

Everything is in the model's own frame, which has no scale and any direction: scene.frame brings it to the robot.
Cameras are pinholes; pixel (0, 0) is the top-left corner of the top-left pixel, as everywhere here.
"""

import json
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from scene import album
from scene.colmap import worker
from scene.dataset import FEWEST_PHOTOGRAPHS, is_rotated, load_image, read_mask, read_points, save_mask
from scene.model import Model, ReconstructionFailed
from scene.transforms import Posed

LEAST_BYTES = {"cameras.bin": 40, "images.bin": 73, "points3D.bin": 51}
"""Of one record of COLMAP's binary files."""


def reconstruct(
    photographs: Sequence[str | Path],
    work: str | Path,
    *,
    seed: int = 0,
    camera_model: str = "SIMPLE_RADIAL",
    single_camera: bool = True,
    features: int = 4096,
    feature_size: int = 1600,
    max_size: int = 1024,
    exhaustive: int = 80,
    alike: int = 20,
    threads: int = 1,
    progress: bool = True,
    masks: Mapping[str, Path] | None = None,
) -> Model:
    """Register photographs (as scene.album.load_photographs lists them) with each other; write ``work``, see above.

    camera_model: COLMAP's name of the lens model. single_camera: photographs that scene.album.cameras takes for one camera's
    were taken with one lens and zoom.
    features: at most so many in a photograph. feature_size: longest side [px] at which they are sought.
    max_size: longest side [px] of the undistorted pictures. exhaustive: up to so many photographs every pair is
    matched; of more, each with its neighbours by name and ``alike`` that look alike (scene.colmap.retrieval). threads: with 1
    the same seed gives the same model, bit by bit; more are faster. masks: {photograph's name: file}, see scene.masks.
    Raises ReconstructionFailed when fewer than three or fewer than half of the photographs join.
    """
    photographs, work = [Path(p).absolute() for p in photographs], Path(work)
    named, root = album.named(photographs), album.root(photographs)
    if any(p.parent == (work / "images").absolute() for p in photographs):
        raise ValueError(f"the photographs lie in {work / 'images'}, where undistorted ones are written; move them")
    unfinished = work / ".colmap.part"
    shutil.rmtree(unfinished, ignore_errors=True)
    (unfinished / "photographs").mkdir(parents=True)
    try:
        for name, path in named.items():
            inside = path.relative_to(root)
            _lay_out(path, unfinished / "photographs" / inside)
            if name in (masks or {}):  # COLMAP wants the whole name before the ending
                save_mask(unfinished / "masks" / f"{inside}.png", read_mask(masks[name]))
        groups = [sorted(_below(root, group)) for group in album.cameras(photographs)] if single_camera else None
        settings = {
            "folder": str(unfinished.absolute()), "names": sorted(_below(root, photographs)), "cameras": groups,
            "seed": seed, "camera_model": camera_model, "features": features,
            "feature_size": feature_size, "max_size": max_size, "threads": threads,
            "alike": alike if len(photographs) > exhaustive else None,
        }  # fmt: skip
        return _worked("solve", settings, work, progress)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def adopt(
    given: Posed | Path, images: str | Path, work: str | Path, *, max_size: int = 1024, progress: bool = True,
    fewest: int = FEWEST_PHOTOGRAPHS,
) -> Model:  # fmt: skip
    """Take cameras that are known already as they are, in their own frame; write ``work``, see above.

    given: Posed, or the folder of a COLMAP model whose pictures lie in ``images``. Points of a Posed come without what
    saw them, so the model has no reprojection error (nan). Raises ReconstructionFailed when the model cannot be read,
    fewer than ``fewest`` of its pictures have cameras, or one is missing, of another size, or turned by its EXIF.
    """
    work = Path(work)
    settings = {"images": str(Path(images).absolute()), "max_size": max_size, "fewest": fewest}
    if isinstance(given, Posed):
        points, colours = read_points(given.ply) if given.ply else (np.empty((0, 3)), np.empty((0, 3)))
        settings |= {"names": given.names, "lenses": given.lenses, "poses": given.poses.tolist()}
        settings |= {"masks": {name: str(path.absolute()) for name, path in given.masks.items()}}
        settings |= {"points": points.tolist(), "colours": colours.tolist()}
    else:
        _require_whole(Path(given))
        settings |= {"names": (), "sparse": str(Path(given).absolute())}
    unfinished = work / ".colmap.part"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    try:
        return _worked("adopt", settings | {"folder": str(unfinished.absolute())}, work, progress)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _require_whole(sparse: Path) -> None:
    """Raise ReconstructionFailed where a binary file is shorter than the number of records it states: COLMAP would read on
    for minutes."""
    for name, record in LEAST_BYTES.items():
        path = sparse / name
        if path.is_file():
            with open(path, "rb") as file:
                count = int.from_bytes(file.read(8), "little")
            if path.stat().st_size < 8 + record * count:
                raise ReconstructionFailed(f"{sparse} is not a readable COLMAP model: {name} is cut off or damaged")


def _worked(task: str, settings: dict, work: Path, progress: bool) -> Model:
    """Have the worker fill its folder, and move what it made into place."""
    unfinished = Path(settings["folder"])
    answer = worker.run(settings | {"task": task}, unfinished / "log.txt", progress)
    if "failure" in answer:
        raise ReconstructionFailed(answer["failure"])
    for result in ("images", "colmap"):  # the model comes last: with it the work is whole
        shutil.rmtree(work / result, ignore_errors=True)
        (unfinished / result).replace(work / result)
    return Model.load(work)


def _below(root: Path, photographs: Sequence[Path]) -> list[str]:
    """What COLMAP calls photographs."""
    return [path.relative_to(root).as_posix() for path in photographs]


def _lay_out(source: Path, target: Path):
    """Put a photograph where COLMAP looks; one that EXIF turns is written upright, with the rest of its EXIF."""
    target.parent.mkdir(exist_ok=True, parents=True)
    if not is_rotated(source):
        target.symlink_to(source)
        return
    with Image.open(source) as image:
        exif = image.getexif()
    del exif[ExifTags.Base.Orientation]
    Image.fromarray(load_image(source)).save(target, quality=98, subsampling=0, exif=exif)


def straighten(model: Model, pixels: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Pixels (N, 2) of photographs as they were taken (upright), by name -> of the undistorted pictures of ``model``.

    ValueError for a photograph that is not in the model, or a pixel outside of it.
    """
    given = {name: np.asarray(p, dtype=float).reshape(-1, 2).tolist() for name, p in pixels.items()}
    unknown = sorted(given.keys() - set(model.names))
    if unknown:
        left_out = " (left out by COLMAP)" if unknown[0] in model.unregistered else ""
        raise ValueError(f"no photograph {unknown[0]}{left_out} in the model; there are {', '.join(model.names[:6])}, ...")
    settings = json.dumps({"sparse": str(model.sparse), "pixels": given})
    answer = subprocess.run(worker.command("answer_rays"), input=settings, capture_output=True, text=True)
    if answer.returncode:
        last = answer.stderr.strip().splitlines()[-1:] or ["no message"]
        raise ReconstructionFailed(f"{model.sparse} cannot be read: {last[0][-300:]}")
    answer = json.loads(answer.stdout.splitlines()[-1])
    outside = [name for name in given if answer["outside"][name]]
    if outside:
        raise ValueError(f"photograph {outside[0]} has no pixel {given[outside[0]]}: {answer['outside'][outside[0]]}")
    lenses = {name: camera.K for name, camera in zip(model.names, model.cameras, strict=True)}
    return {name: np.array(rays) @ lenses[name][:2, :2].T + lenses[name][:2, 2] for name, rays in answer["rays"].items()}
