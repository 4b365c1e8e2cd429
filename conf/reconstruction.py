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
    from scene import colmap, masks, transforms
    from scene.dataset import load_photographs
    from scene.inputs import recognise

    source = recognise(photographs)
    size = {"max_size": job.cfg.scene.colmap.max_size, "progress": progress}
    if job.settings("scene.resection"):
        return _by_tags(job, source, out, setting, size)
    if not source.posed:
        if source.kind == "video":
            files = setting(job, "scene.video")(source.path, job.capture / "photos")
            log.info("  %d sharp frames of %s in %s", len(files), source.path.name, job.capture / "photos")
        else:
            files = load_photographs(source.path)
        given = masks.find(files)
        if given:
            log.info("  %d of %d photographs have a mask", len(given), len(files))
        return setting(job, "scene.colmap")(files, out, seed=job.cfg.scene.seed, progress=progress, masks=given), None
    if source.kind == "colmap":
        return colmap.adopt(source.path, source.images, out, **size), Given()
    posed = transforms.read(source.path)
    return colmap.adopt(posed, posed.root, out, **size), Given(posed.frame, posed.original)


def _by_tags(job: Job, source, out: Path, setting, size: dict):
    """The cameras of two photographs or more from the tags that they show."""
    from scene import colmap
    from scene.dataset import load_photographs
    from scene.frame import choose
    from scene.frame.apriltag import TagLayout

    if source.kind != "photographs":
        raise ValueError(f"scene/resection finds the cameras of photographs, and {source.path} is a {source.kind} source: leave it out")
    _, layout, _ = choose(source.folder if job.cfg.photos else job.capture, "tags", job.cfg.scene.frame.file)
    posed = setting(job, "scene.resection")(load_photographs(source.path, fewest=2), TagLayout.load(layout), out)
    log.info("  cameras from %(rests_on)s: residual %(residual_px).2f px, %(residual_mm).1f mm at the tags; "
             "they may be off by %(uncertainty_mm).0f mm", posed.frame)  # fmt: skip
    for warning in posed.frame["warnings"]:
        log.warning("  note: %s", warning)
    return colmap.adopt(posed, posed.root, out, fewest=2, **size), Given(posed.frame, posed.original)
