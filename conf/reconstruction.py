"""Photographs, a video or known cameras -> a model, by what photos= is."""

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from conf.stages import Job

log = logging.getLogger("scene2skill")


@dataclass(frozen=True)
class Given:
    """What is known of the frame of a scene whose cameras were given: as scene.dataset.save_views takes it."""

    frame: dict = field(default_factory=lambda: {"name": "arbitrary", "unit": "arbitrary"})
    original: np.ndarray = field(default_factory=lambda: np.eye(4))


def model_of(job: Job, photographs: Path, out: Path, setting, progress: bool):
    """(Model in ``out``, Given or None where COLMAP had to find the cameras). setting(job, key): as in conf.pipeline."""
    from scene import colmap, transforms
    from scene.dataset import load_photographs
    from scene.inputs import recognise

    source = recognise(photographs)
    if job.capture.resolve() == source.folder.resolve():
        raise ValueError(f"{source.folder} is both what is read and where the scene is written: say data=ANOTHER_FOLDER")
    if not source.posed:
        if source.kind == "video":
            files = setting(job, "scene.video")(source.path, job.capture / "photos")
            log.info("  %d sharp frames of %s in %s", len(files), source.path.name, job.capture / "photos")
        else:
            files = load_photographs(source.path)
        return setting(job, "scene.colmap")(files, out, seed=job.cfg.scene.seed, progress=progress), None
    size = {"max_size": job.cfg.scene.colmap.max_size, "progress": progress}
    if source.kind == "colmap":
        return colmap.adopt(source.path, source.images, out, **size), Given()
    posed = transforms.read(source.path)
    return colmap.adopt(posed, posed.root, out, **size), Given(posed.frame, posed.original)
