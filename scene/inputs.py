"""What a person gives as photographs: pictures, a video, or pictures whose cameras are known already.

    photographs    a folder of pictures, or of one folder a camera          -> COLMAP finds the cameras (scene.album)
    video          .mp4, .mov, .avi, ...                                    -> sharp frames (scene.video), then COLMAP
    transforms     a transforms.json (nerfstudio, instant-ngp) or its folder  -> cameras as they are (scene.transforms)
    colmap         a folder with sparse/0 and images                        -> cameras as they are (scene.colmap.adopt)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scene.album import places

VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm")
TRANSFORMS = ("transforms.json", "transforms_train.json")
SPARSE = ("sparse/0", "sparse", "colmap/sparse/0")


@dataclass(frozen=True)
class Source:
    """kind: one of the four above. path: folder of photographs, video, transforms.json or folder of the COLMAP model.

    folder: where tags.json may lie. images: of a COLMAP model, the folder of its pictures.
    """

    kind: str
    path: Path
    folder: Path
    images: Path | None = None

    @property
    def posed(self) -> bool:
        """Whether the cameras are known already."""
        return self.kind in ("transforms", "colmap")

    def files(self) -> Sequence[Path]:
        """All that goes in, sorted."""
        if self.kind == "video":
            return [self.path]
        if self.kind == "transforms":
            from scene.transforms import read

            given = read(self.path)
            return [self.path, *given.files(), *([given.ply] if given.ply else [])]
        if self.kind == "colmap":
            parts = [self.path.glob("*"), self.images.rglob("*")]
        else:
            found = places(self.path)
            top = found[0] if len(found) == 1 else self.path
            beside = {folder / "masks" for folder in (top, top.parent)}
            parts = [folder.glob("*") for folder in {self.path, *found, *beside}]
        return sorted({path for part in parts for path in part if path.is_file()})


def recognise(given: str | Path) -> Source:
    """What ``given`` is. Raises FileNotFoundError if it is not there, ValueError if it is nothing of the above."""
    path = Path(given)
    if path.is_file():
        if path.suffix.lower() in VIDEOS:
            return Source("video", path, path.parent)
        if path.suffix.lower() == ".json":
            return Source("transforms", path, path.parent)
        raise ValueError(f"{path} is neither a video ({' '.join(VIDEOS)}) nor a transforms.json nor a folder")
    if not path.is_dir():
        raise FileNotFoundError(f"no such folder of photographs, transforms.json or video: {path}")
    for name in TRANSFORMS:
        if (path / name).is_file():
            return Source("transforms", path / name, path)
    for name in SPARSE:
        if any((path / name / f"cameras.{ending}").is_file() for ending in ("bin", "txt")):
            if not (path / "images").is_dir():
                raise FileNotFoundError(f"{path} has a COLMAP model, but no folder images with its pictures beside it")
            return Source("colmap", path / name, path, path / "images")
    return Source("photographs", path, path)


def scene_name(given: str | Path) -> str:
    """What a scene made of ``given`` is called: by its folder, or by its video."""
    path = Path(given).resolve()
    if path.suffix.lower() == ".json":
        return path.parent.name
    return path.stem if path.suffix.lower() in VIDEOS else path.name
