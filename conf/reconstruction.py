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
    from scene import album, colmap, masks, transforms
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
            files = album.load_photographs(source.path)
            if ignored := album.unused(source.path):
                log.warning("  note: pictures lie in %s itself, those in its subfolders (%s) are not used",
                            source.path, ", ".join(place.name for place in ignored))  # fmt: skip
        given = masks.find(files)
        if given:
            log.info("  %d of %d photographs have a mask", len(given), len(files))
        model = setting(job, "scene.colmap")(files, out, seed=job.cfg.scene.seed, progress=progress, masks=given)
        _say_cameras(files, model)
        return model, None
    if source.kind == "colmap":
        return colmap.adopt(source.path, source.images, out, **size), Given()
    posed = transforms.read(source.path)
    return colmap.adopt(posed, posed.root, out, **size), Given(posed.frame, posed.original)


def _say_cameras(files: list[Path], model) -> None:
    """Which cameras the registered photographs are of, if there are several."""
    from scene import album

    named = album.named(files)
    groups = album.cameras([named[name] for name in model.names])
    if len(groups) > 1:
        log.info("  %s", album.described(groups))


def _by_tags(job: Job, source, out: Path, setting, size: dict):
    """The cameras of two photographs or more from the tags that they show."""
    from scene import album, colmap
    from scene.frame import choose
    from scene.frame.apriltag import TagLayout

    if source.kind != "photographs":
        raise ValueError(f"scene/resection finds the cameras of photographs, and {source.path} is a {source.kind} source: leave it out")
    _, layout, _ = choose(source.folder if job.cfg.photos else job.capture, "tags", job.cfg.scene.frame.file)
    posed = setting(job, "scene.resection")(album.load_photographs(source.path, fewest=2), TagLayout.load(layout), out)
    log.info("  cameras from %(rests_on)s: residual %(residual_px).2f px, %(residual_mm).1f mm at the tags; "
             "they may be off by %(uncertainty_mm).0f mm", posed.frame)  # fmt: skip
    for warning in posed.frame["warnings"]:
        log.warning("  note: %s", warning)
    return colmap.adopt(posed, posed.root, out, fewest=2, **size), Given(posed.frame, posed.original)
