"""Pictures along a camera path: data/<capture>/renders/<path>/ and its video beside it."""

import hashlib
from pathlib import Path

from filelock import FileLock
from hydra.utils import instantiate
from omegaconf import OmegaConf

from conf.stages import Job


def render_path(job: Job, progress) -> dict[str, int | Path]:
    """Render the path that scene/paths names; returns the "folder", its "frames" and how many were "rendered" now."""
    from robot.execution import save_video
    from scene.dataset import load_frame, load_views
    from scene.field import Field

    missing = OmegaConf.missing_keys(job.cfg.scene.paths)
    if missing:
        raise ValueError(f"this path needs {missing.pop()}=...")
    cameras, make = [view.camera for view in load_views(job.capture)], instantiate(job.cfg.scene.paths, _convert_="all")
    file = job.capture / "field.pt"
    identity, field = hashlib.sha256(file.read_bytes()).hexdigest(), Field.load(file)
    path = make(cameras, field=field, workspace=workspace(job)) if "suggest" in job.cfg.scene.paths else make(cameras)
    folder = job.capture / "renders" / _name(job)
    folder.parent.mkdir(exist_ok=True)
    with FileLock(job.capture / ".stages" / "renders.lock"):
        counted = instantiate(job.cfg.scene.film, _convert_="all")(
            field, path, folder, identity=identity, frame=load_frame(job.capture),
            save_video=save_video, progress=progress,
        )  # fmt: skip
    return counted | {"folder": folder}


def _name(job: Job) -> str:
    """The path's own name: what made it, or the file it was read from."""
    file = job.settings("scene.paths.file")
    return Path(file).stem if file else job.settings("scene.paths._target_").rsplit(".", 1)[-1]


def workspace(job: Job) -> list | None:
    """Lower and upper corner [m] of where motions are meant: as set, or the world's; None of own photographs else."""
    world = {} if job.cfg.photos else job.settings("world.workspace") or {}
    return job.settings("scene.viewpoints.workspace") or [world[side] for side in ("lower", "upper") if world] or None
