"""A folder of photographs: which pictures count, what they are called, and which camera took each.

    photos/*.jpg                               a flat folder
    photos/left/*.jpg, photos/right/*.jpg      one folder for each camera, where photos/ holds no pictures of its own

A photograph of a flat folder (or of one subfolder alone) is called by its file without the ending, ``0001``; one of
several subfolders by both, ``left_0001``. Files that speak of photographs (masks, arm_poses.json, ...) use these names.

Pictures are of one camera if they lie in one folder, have one size upright and their EXIF tells one model and focal
length [mm]. So a phone that is turned is two cameras: its principal point turns with it.
"""

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from PIL import ExifTags, Image

from scene.dataset import EXTENSIONS, FEWEST_PHOTOGRAPHS, load_image

NO_CAMERAS = (
    "masks", "poses", "sparse", "colmap", "dense", "depth", "depths", "views", "sketches", "collision", "held_out", "moved",
)  # fmt: skip
"""Subfolders that lie beside photographs for another purpose; ``images_2``, ... are smaller copies of ``images``."""


def load_photographs(folder: str | Path, fewest: int = FEWEST_PHOTOGRAPHS) -> list[Path]:
    """The pictures of a folder, sorted by path, each of them decoded once to its last byte.

    fewest: how many there must be. Raises FileNotFoundError (no such folder, no pictures) or ValueError (too few,
    unreadable, truncated, two of one name).
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"no such folder of photographs: {folder}")
    paths = [path for place in places(folder) for path in pictures(place)]
    if not paths:
        files = [p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")]
        counts = sorted(Counter(p.suffix for p in files).items())
        there = ", ".join(f"{n} {s or 'without extension'}" for s, n in counts)
        wanted = " ".join(EXTENSIONS)
        there = there or "no files"
        raise FileNotFoundError(f"no pictures in {folder} and its subfolders: looked for {wanted}; there: {there}")
    if len(paths) < fewest:
        names = ", ".join(p.name for p in paths)
        needed = f"a scene needs at least {fewest}" + ", better 30" * (fewest == FEWEST_PHOTOGRAPHS)
        raise ValueError(f"only {len(paths)} pictures in {folder} ({names}); {needed}")
    named(paths)
    for path in paths:
        load_image(path)  # a truncated file shows only at its end
    return paths


def pictures(folder: Path) -> list[Path]:
    """The pictures that lie in a folder itself, sorted."""
    seen = (p for p in folder.iterdir() if not p.name.startswith("."))
    return sorted(p for p in seen if p.suffix.lower() in EXTENSIONS and p.is_file())


def places(folder: Path) -> list[Path]:
    """The folders whose pictures count: ``folder``, or its subfolders where it holds none itself."""
    return [folder] if pictures(folder) else subfolders(folder)


def unused(folder: Path) -> list[Path]:
    """Subfolders with pictures that do not count, as pictures lie in ``folder`` itself."""
    return subfolders(folder) if pictures(folder) else []


def subfolders(folder: Path) -> list[Path]:
    """Subfolders with pictures that could be photographs, sorted."""
    inside = [p for p in folder.iterdir() if p.is_dir() and not p.name.startswith((".", "_", "@"))]
    possible = [p for p in inside if p.name not in NO_CAMERAS and not re.fullmatch(r"images_\d+", p.name)]
    return sorted(p for p in possible if pictures(p))


def root(photographs: Sequence[Path]) -> Path:
    """The folder below which all photographs lie."""
    return Path(os.path.commonpath([path.parent for path in photographs]))


def flat(name: str) -> str:
    """What a picture is called, of its path below the root (COLMAP's name for it)."""
    return str(Path(name).with_suffix("")).replace(os.sep, "_")


def named(photographs: Sequence[Path]) -> dict[str, Path]:
    """{name: photograph}; ValueError where two have one name."""
    top, found = root(photographs), {}
    for path in photographs:
        name = flat(str(path.relative_to(top)))
        if name in found:
            raise ValueError(f"two pictures are called {name}: {found[name]} and {path}; rename or take away one of them")
        found[name] = path
    return found


def cameras(photographs: Sequence[Path]) -> list[list[Path]]:
    """The photographs of each camera, in the order of their first ones."""
    groups = {}
    for path in photographs:
        groups.setdefault(_camera_key(path), []).append(path)
    return list(groups.values())


def _camera_key(path: Path) -> tuple:
    with Image.open(path) as image:
        exif = image.getexif()
        told = exif.get_ifd(ExifTags.IFD.Exif)
        return path.parent, _upright_size(image), str(exif.get(ExifTags.Base.Model)), str(told.get(ExifTags.Base.FocalLength))


def size(path: Path) -> tuple[int, int]:
    """(width, height) [px] of a picture after EXIF rotation, without decoding it."""
    with Image.open(path) as image:
        return _upright_size(image)


def _upright_size(image: Image.Image) -> tuple[int, int]:
    turned = image.getexif().get(ExifTags.Base.Orientation, 1) in (5, 6, 7, 8)
    return image.size[::-1] if turned else image.size


def described(groups: Sequence[Sequence[Path]]) -> str:
    """In words which cameras there are: "2 cameras: 30 of 640x480, 12 of 480x640"; by folder where there are many."""
    several = len({path.parent for group in groups for path in group}) > 1
    parts = []
    for group in groups:
        width, height = size(group[0])
        parts.append(f"{f'{group[0].parent.name} ' * several}{len(group)} of {width}x{height}")
    return f"{len(groups)} cameras: {', '.join(parts)}"
