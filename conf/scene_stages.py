"""Stages that make the scene: photographs -> cameras -> field -> mesh and views to sketch on.

Each function reads the files of the stages before, calls one room of the house, writes its own files into ``out`` and
returns what it measured.
"""

import hashlib
import json
import logging
import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from conf.stages import Job, progress, setting, watched, write_json
from scene.inputs import recognise

log = logging.getLogger("scene2skill")

POOR_DB = 17.0
"""Held-out photographs that a field shows worse than this are said to be shown poorly: scenes of photographs that do not belong
together came to 12 to 14 dB, sound ones to 24 after 20 s of training."""


def capture(job: Job, out: Path) -> dict:
    """A simulated world is photographed, as a person with a camera would."""
    from robot.world import World
    from scene.dataset import save_image
    from scene.frame.apriltag import TagLayout

    photographer = setting(job, "robot.photographs")
    with World.from_spec(job.settings("world")) as world:
        cameras = photographer(world.spec, seed=job.cfg.scene.seed)
        for i, camera in enumerate(progress(cameras, "photographs")):
            save_image(out / "photos" / f"{i:04d}.png", world.photograph(camera))
        TagLayout(world.tag_size, world.base_from_tag).save(out / "tags.json")
    truth = {f"{i:04d}": camera.plain() for i, camera in enumerate(cameras)}
    write_json(out / "truth.json", {"world": job.settings("world"), "cameras": truth})
    return {"photographs": len(cameras)}


def reconstruct(job: Job, out: Path) -> dict:
    """COLMAP finds the cameras, unless they are given; what lies beside the photographs (tags.json, ...) gives the robot's frame."""
    import numpy as np

    from conf.evaluation import camera_errors
    from conf.reconstruction import model_of
    from scene.dataset import save_views

    frame_of = setting(job, "scene.frame")(_beside(job))
    model, given = model_of(job, photographs(job), out, setting, watched())
    metrics = {"registered": model.registered, "total": model.total}
    if np.isfinite(model.reprojection_px):
        metrics["reprojection_px"] = model.reprojection_px
        log.info("  %(registered)d of %(total)d photographs registered, reprojection error %(reprojection_px).2f px", metrics)
    else:
        log.info("  %(registered)d photographs with their cameras", metrics)
    if model.unregistered:
        log.warning("  left out: %s", ", ".join(model.unregistered))
    original = np.eye(4) if given is None else given.original
    if given is not None and (given.frame["name"] == "robot base" or _frame_method(job) == "gravity"):
        views, points, known = model.views(), model.points, {"frame": given.frame, "original": original}
        log.info("  the cameras' frame is kept as it is: %(name)s, unit %(unit)s", given.frame)
    else:
        frame = frame_of(model)
        views = [replace(view, camera=frame.move(view.camera)) for view in model.views()]
        points, known = frame.apply(model.points), {"frame": frame.describe(), "original": frame.matrix @ original}
        metrics |= {f"frame_{key}": mm for key, mm in frame.describe().items() if key in ("residual_mm", "uncertainty_mm")}
        residual = ", residual %(frame_residual_mm).1f mm" % metrics if "frame_residual_mm" in metrics else ""
        log.info("  frame: %s, from %s%s", frame.frame, frame.rests_on, residual)
        for warning in frame.warnings:
            log.warning("  note: %s", warning)
    save_views(out, views, points=points, colours=model.colours, **known)
    return metrics | camera_errors(views, _truth(job))


def train(job: Job, out: Path) -> dict:
    """The field learns the scene from all photographs but every eighth, which measure it."""
    from conf.evaluation import field_errors
    from scene.dataset import load_points, load_views
    from scene.moved import moved
    from scene.photographs import spoilt

    views = load_views(job.capture)
    points, _ = load_points(job.capture)
    useless = spoilt(views)
    training, held_out = (_telling(part, useless) for part in split(views))
    if useless:
        log.warning("  note: too dark or overexposed to learn from, left out: %s", ", ".join(useless))
    started = time.perf_counter()
    field = setting(job, "scene.fit")(
        training, points=points if len(points) else None, seed=job.cfg.scene.seed,
        checkpoint=out / "checkpoint.npz", progress=watched(),
    )  # fmt: skip
    metrics = {"seconds": time.perf_counter() - started}
    field.save(out / "field.pt")
    metrics |= field_errors(field, held_out, out / "held_out", job.settings("world") if _truth(job) else None)
    log.info("  held-out views: %(psnr).1f dB; a view renders in %(render_seconds).2f s", metrics)
    if metrics["psnr"] < POOR_DB:
        log.warning("  note: the field shows held-out photographs poorly; look at %s. Were things moved between the photographs, are "
                    "they of several scenes, or exposed very differently?", out / "held_out")  # fmt: skip
    return metrics | {"moved": _show_moved(moved(field, training, partial(progress, title="compare")), job, out / "moved")}


def _show_moved(odd, job: Job, folder: Path) -> int:
    """Photographs that show a thing where the others do not have it are named, and drawn into ``folder``."""
    from scene.dataset import save_image

    folder.mkdir(exist_ok=True)
    for one in odd:
        save_image(folder / f"{one.view.name}.png", one.picture())
    if odd:
        names = ", ".join(one.view.name for one in odd)
        log.warning("  note: %s: something there looks otherwise than in the other photographs (marked in %s). Was a thing moved, or somebody in "
                    "the picture? It stands blurred in the field: take photographs anew, leave these out or hide it by masks.",
                    names, job.capture / "moved")  # fmt: skip
    return len(odd)


def split(views) -> tuple[list, list]:
    """Training views and held-out views: every eighth by name (i % 8 == 4)."""
    by_name = sorted(views, key=lambda view: view.name)
    return [v for i, v in enumerate(by_name) if i % 8 != 4], [v for i, v in enumerate(by_name) if i % 8 == 4]


def _telling(views, useless) -> list:
    """``views`` without the useless ones, unless nothing else is left."""
    return [view for view in views if view.name not in useless] or views


def surface(job: Job, out: Path) -> dict:
    """The field becomes a mesh, convex pieces for planning, and what of space is free, occupied, unseen."""
    from scene.dataset import load_views, save_image
    from scene.field import Field
    from scene.paths import orbit
    from scene.surface import drawn
    from scene.surface.space import FREE, UNSEEN

    cameras = {view.name: view.camera for view in load_views(job.capture)}
    field = Field.load(job.capture / "field.pt")
    found = setting(job, "scene.surface")(field, cameras, out / "depths", progress=partial(progress, title="depth"))
    found.save(out)
    (around, *_) = orbit(list(cameras.values()), frames=1).cameras.values()
    save_image(out / "mesh.png", drawn(found.mesh, around.cropped(960, 720)))
    free, unseen = (float((found.space.labels == label).mean()) for label in (FREE, UNSEEN))
    metrics = {"triangles": len(found.mesh.faces), "pieces": len(found.pieces), "free": free, "unseen": unseen}
    log.info("  %(triangles)d triangles, %(pieces)d convex pieces; of the space around, %(free).0f %% free, %(unseen).0f %% unseen",
             metrics | {"free": 100 * free, "unseen": 100 * unseen})  # fmt: skip
    return metrics


def render(job: Job, out: Path) -> dict:
    """Views to sketch on, and an orbit to look around."""
    from conf.rendering import workspace
    from robot.execution import save_video
    from scene.dataset import load_frame, load_views, save_views
    from scene.field import Field
    from scene.views import render
    from teach import sketch as sketch_files

    field = Field.load(job.capture / "field.pt")
    photographed = [view.camera for view in load_views(job.capture)]
    eyes = None if job.cfg.photos else _varied_world(job)["sketch_views"]
    known = {"sketch": sketch_files.load(before)} if (before := _before(job)) else {}
    chosen = setting(job, "scene.views")(photographed, eyes, field=field, workspace=workspace(job), **known)
    for sentence in chosen.why:
        log.info("  %s", sentence)
    views = render(field, chosen.sketch, out / "views", partial(progress, title="views"))
    save_views(out / "views", views, images=".", frame=load_frame(job.capture))
    frames = render(field, chosen.orbit, out / "views" / "orbit", partial(progress, title="orbit"), depth=False)
    if frames:
        save_video(out / "views" / "orbit.mp4", [frame.image for frame in frames], fps=8)
    return {"views": len(views), "orbit": len(frames)}


def true_views(job: Job, out: Path) -> dict:
    """The simulated world itself at its sketch views, cameras and depth as they are: nothing photographed, nothing learned."""
    import numpy as np

    from robot.world import World
    from scene.camera import View
    from scene.dataset import save_image, save_views
    from scene.views import save_depth

    views = []
    with World.from_spec(job.settings("world")) as world:
        for name, camera in setting(job, "scene.views")([], world.spec["sketch_views"], orbit=0).sketch.items():
            image, depth = world.photograph_with_depth(camera)
            save_image(out / "views" / f"{name}.png", image)
            save_depth(out / "views", name, depth, np.isfinite(depth))
            views.append(View(name, camera, image))
    save_views(out / "views", views, images=".", frame={"name": "robot base", "unit": "metre"})
    return {"views": len(views)}


def drawn_before(job: Job) -> str | None:
    """The contents of what was drawn before the next view is chosen."""
    path = _before(job)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path else None


def _before(job: Job) -> Path | None:
    """scene.views.sketch: what was drawn before the next view is chosen."""
    from omegaconf import OmegaConf

    if missing := OmegaConf.missing_keys(job.cfg.scene.views):
        raise ValueError(f"these views need {missing.pop()}=...: a name in {job.capture / 'sketches'}, or a file")
    name = job.settings("scene.views.sketch")
    return stored_sketches(job, name) if name else None


def stored_sketches(job: Job, name: str) -> Path:
    """A name in the capture's sketches folder, or a path."""
    folder = job.capture / "sketches"
    for path in (folder / f"{name}.json", folder / name, Path(name)):
        if path.is_file():
            return path
    there = ", ".join(sorted(path.stem for path in folder.glob("*.json"))) or "none"
    raise FileNotFoundError(f"there are no sketches {name!r}: give the path of a file, or a name in {folder} ({there})")


def fingerprint(job: Job) -> dict[str, str]:
    """Names and contents of what is reconstructed and of its frame, so that other photographs are another scene."""
    from scene.frame import choose

    source = recognise(photographs(job)) if job.cfg.photos or photographs(job).exists() else None
    if source and job.capture.resolve() == source.folder.resolve():
        raise ValueError(f"{source.folder} is both what is read and where the scene is written: say data=ANOTHER_FOLDER")
    files = {os.path.relpath(path, source.folder): path for path in source.files()} if source else {}
    _, chosen, others = choose(_beside(job), job.cfg.scene.frame.method, job.cfg.scene.frame.file)
    for path in (*([chosen] if chosen else []), *others):
        inside = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path] * path.exists()
        files |= {one.name: one for one in inside}
    went_in = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    return went_in | ({"scene.video": str(job.settings("scene.video"))} if source and source.kind == "video" else {})


def photographs(job: Job) -> Path:
    return Path(job.cfg.photos) if job.cfg.photos else job.capture / "photos"


def _beside(job: Job) -> Path:
    """Where the files lie that give the robot's frame: with the photographs, or where the world's capture left them."""
    return recognise(job.cfg.photos).folder if job.cfg.photos else job.capture


def _frame_method(job: Job) -> str:
    """What the frame rests on: "gravity" where nothing gives it."""
    from scene.frame import choose

    return choose(_beside(job), job.cfg.scene.frame.method, job.cfg.scene.frame.file)[0]


def _truth(job: Job) -> dict | None:
    """What only the scripted user and evaluation may know: there is none of real photographs."""
    path = job.capture / "truth.json"
    return None if job.cfg.photos or not path.exists() else json.loads(path.read_text())


def _varied_world(job: Job) -> dict:
    """The world's data as it is built, under its seed."""
    from robot.variation import varied

    return varied(job.settings("world"))
