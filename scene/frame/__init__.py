"""The robot's frame of a reconstruction: a model of photographs alone has no scale, no up and no origin.

What gives it one lies in a file beside the photographs; the first that is there is used:

    tags.json          AprilTags at known places                                        scene.frame.apriltag
    poses.json, poses  camera poses that are known already                              scene.frame.poses
    arm_poses.json     where the arm's flange was at each photograph                    scene.frame.handeye
    distance.json      two points and the distance between them; up is gravity's        scene.frame.distance
    (none)             up is gravity's; scale and place are arbitrary                   scene.frame.gravity

Notation
    x_base = s R x_model + t     the Similarity (s, R, t) from the model's frame to the robot's base
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from scene.frame.similarity import Similarity
from scene.model import Model

FILES = {
    "tags": ("tags.json",),
    "poses": ("poses.json", "poses"),
    "arm": ("arm_poses.json",),
    "distance": ("distance.json",),
}
METHODS = ("auto", *FILES, "gravity")


def find(model: Model, folder: str | Path, *, method: str = "auto", file: str | Path | None = None) -> Similarity:
    """The frame of a model from the files in ``folder``, beside the photographs; ``file`` goes before these.

    Raises ReconstructionFailed where the frame cannot be known, ValueError or FileNotFoundError for a broken file.
    """
    return read(folder, method=method, file=file)(model)


def read(folder: str | Path, *, method: str = "auto", file: str | Path | None = None) -> Callable[[Model], Similarity]:
    """What gives the frame, read and checked before there is a model: a function from the model to its frame."""
    wished = method
    method, file, others = choose(folder, method, file)
    fit = _read(method, file)
    notes = []
    if others:
        notes = [f"not used: {', '.join(p.name for p in others)}; scene/frame= chooses what the frame rests on"]
    if wished == "auto" and method == "gravity":
        files = ", ".join(name for names in FILES.values() for name in names[:1])
        notes = [f"none of {files} lies with the photographs: nothing gives scale and place"]

    def frame_of(model: Model) -> Similarity:
        found = fit(model)
        return replace(found, warnings=(*found.warnings, *notes))

    return frame_of


def _read(method: str, file: Path | None) -> Callable[[Model], Similarity]:
    if method == "tags":
        from scene.frame.apriltag import TagLayout, align

        return partial(align, layout=TagLayout.load(file))
    if method == "poses":
        from scene.frame.poses import align, load

        return partial(align, base_from_camera=load(file))
    if method == "arm":
        from scene.frame.handeye import align, load

        return partial(align, base_from_flange=load(file))
    if method == "distance":
        from scene.frame.distance import Ruler, align

        return partial(align, ruler=Ruler.load(file))
    from scene.frame.gravity import align

    return align


def choose(
    folder: str | Path, method: str = "auto", file: str | Path | None = None
) -> tuple[str, Path | None, list[Path]]:
    """(method, its file, files of other methods that are there too and stay unused)."""
    if method not in METHODS:
        raise ValueError(f"unknown scene.frame.method {method}; there are {', '.join(METHODS)}")
    if file is not None and method not in FILES:
        raise ValueError(f"scene.frame.file={file} needs scene/frame= to say what it is: {', '.join(FILES)}")
    there = {kind: [p for p in (Path(folder) / name for name in names) if p.exists()] for kind, names in FILES.items()}
    if method == "auto":
        method, *rest = [kind for kind in FILES if there[kind]] or ["gravity"]
        return method, there[method][0] if method in FILES else None, [there[kind][0] for kind in rest]
    if method == "gravity":
        return method, None, []
    if file is None and not there[method]:
        wanted = " or ".join(FILES[method])
        raise FileNotFoundError(f"scene/frame={method} needs {wanted} in {folder}, or scene.frame.file")
    return method, Path(file) if file is not None else there[method][0], []
