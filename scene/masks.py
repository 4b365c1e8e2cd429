"""What of a photograph is not to be looked at: people, reflections, the robot itself.

    masks/<name>.png        beside the photographs or in their folder, named like them (scene.album): black is ignored, as in
                            nerfstudio

Ignored pixels get no features in COLMAP and teach the field nothing. A photograph without a mask is used whole.
"""

from collections.abc import Sequence
from pathlib import Path

from scene.album import named as photographs_named
from scene.album import pictures, root, subfolders
from scene.dataset import load_image, read_mask

FOLDER = "masks"


def find(photographs: Sequence[Path]) -> dict[str, Path]:
    """{photograph's name: file of its mask} for photographs, see scene.album; none where there is no folder of masks.

    Raises ValueError for masks of no photograph, of another size than theirs, or that leave nothing.
    """
    if not photographs:
        return {}
    top = root(photographs)
    places = top / FOLDER, top.parent / FOLDER
    folder = next((place for place in places if place.is_dir()), None)
    if folder is None:
        return {}
    files, names = pictures(folder), photographs_named(photographs)
    deeper = [place for place in subfolders(folder) if place.name in {path.parent.name for path in photographs}]
    if deeper:
        raise ValueError(f"masks in a subfolder are not read: {deeper[0]}; name them {FOLDER}/{next(iter(names))}.png, ...")
    named = {_name(path, names): path for path in files}
    strangers = [path.name for name, path in named.items() if name not in names]
    if strangers:
        which, there = ", ".join(strangers[:6]), ", ".join(list(names)[:3])
        raise ValueError(f"{folder} holds masks of no photograph: {which}; photographs are {there}, ...")
    for name, path in named.items():
        check(path, load_image(names[name]).shape[:2])
    return named


def _name(path: Path, names) -> str:
    """Of 0001.png, and of 0001.jpg.png as COLMAP has it, the photograph's 0001."""
    return path.stem if path.stem in names else Path(path.stem).stem


def check(path: Path, shape: tuple[int, int]) -> None:
    """Raise ValueError unless the mask is of that (height, width) and leaves something to look at."""
    mask = read_mask(path)
    if mask.shape != tuple(shape):
        said, is_ = (f"{w}x{h}" for h, w in (shape, mask.shape))
        raise ValueError(f"mask {path} is {is_}, its photograph (upright) {said}")
    if not mask.any():
        raise ValueError(f"mask {path} is all black: nothing of its photograph is left; white is looked at")


