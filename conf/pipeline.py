"""The whole job: photographs -> cameras -> field -> views -> sketches -> skill -> plan -> motion -> report.

Each function below is one stage: it reads the files of the stages before, calls one room of the house, writes its own
files into ``out`` and returns what it measured.

    scene2skill                            the whole job on the embedded world
    scene2skill -m seed=0,1,2              a sweep; the scene is built once
    python -m conf.pipeline stages=[fit]   one stage on the files of the one before (also: python -m teach.fit)
"""

import hashlib
import json
import logging
import os
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from hydra.utils import instantiate

from conf import stages
from conf.run import launch
from conf.stages import Job, Record, Stage, write_json
from scene.inputs import recognise

log = logging.getLogger("scene2skill")

DRAWN_ON = ("view1", "view2", "view3")


def capture(job: Job, out: Path) -> dict:
    """A simulated world is photographed, as a person with a camera would."""
    from robot.world import World
    from scene.apriltag import TagLayout
    from scene.dataset import save_image

    hemisphere = _setting(job, "robot.photographs")
    with World.from_spec(job.settings("world")) as world:
        cameras = hemisphere(world.spec["view"], seed=job.cfg.scene.seed)
        for i, camera in enumerate(_progress(cameras, "photographs")):
            save_image(out / "photos" / f"{i:04d}.png", world.photograph(camera))
        TagLayout(world.tag_size, world.base_from_tag).save(out / "tags.json")
    truth = {f"{i:04d}": _plain_camera(camera) for i, camera in enumerate(cameras)}
    write_json(out / "truth.json", {"world": job.settings("world"), "cameras": truth})
    return {"photographs": len(cameras)}


def reconstruct(job: Job, out: Path) -> dict:
    """COLMAP finds the cameras, unless they are given; what lies beside the photographs (tags.json, ...) gives the robot's frame."""
    import numpy as np

    from conf.evaluation import camera_errors
    from conf.reconstruction import model_of
    from scene.dataset import save_views

    frame_of = _setting(job, "scene.frame")(_beside(job))
    model, given = model_of(job, _photographs(job), out, _setting, _watched())
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

    views = load_views(job.capture)
    points, _ = load_points(job.capture)
    training, held_out = split(views)
    started = time.perf_counter()
    field = _setting(job, "scene.fit")(
        training, points=points if len(points) else None, seed=job.cfg.scene.seed,
        checkpoint=out / "checkpoint.npz", progress=_watched(),
    )  # fmt: skip
    metrics = {"seconds": time.perf_counter() - started}
    field.save(out / "field.pt")
    metrics |= field_errors(field, held_out, out / "held_out", job.settings("world") if _truth(job) else None)
    log.info("  held-out views: %(psnr).1f dB; a view renders in %(render_seconds).2f s", metrics)
    return metrics


def split(views) -> tuple[list, list]:
    """Training views and held-out views: every eighth by name (i % 8 == 4)."""
    by_name = sorted(views, key=lambda view: view.name)
    return [v for i, v in enumerate(by_name) if i % 8 != 4], [v for i, v in enumerate(by_name) if i % 8 == 4]


def surface(job: Job, out: Path) -> dict:
    """The field becomes a mesh, convex pieces for planning, and what of space is free, occupied, unseen."""
    from scene.dataset import load_views, save_image
    from scene.field import Field
    from scene.paths import orbit
    from scene.space import FREE, UNSEEN
    from scene.surface import drawn

    cameras = {view.name: view.camera for view in load_views(job.capture)}
    field = Field.load(job.capture / "field.pt")
    found = _setting(job, "scene.surface")(field, cameras, out / "depths", progress=partial(_progress, title="depth"))
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
    known = {"sketch": sketch_files.load(before)} if (before := _drawn_before(job)) else {}
    chosen = _setting(job, "scene.views")(photographed, eyes, field=field, workspace=workspace(job), **known)
    for sentence in chosen.why:
        log.info("  %s", sentence)
    views = render(field, chosen.sketch, out / "views", partial(_progress, title="views"))
    save_views(out / "views", views, images=".", frame=load_frame(job.capture))
    frames = render(field, chosen.orbit, out / "views" / "orbit", partial(_progress, title="orbit"), depth=False)
    if frames:
        save_video(out / "views" / "orbit.mp4", [frame.image for frame in frames], fps=8)
    return {"views": len(views), "orbit": len(frames)}


def true_views(job: Job, out: Path) -> dict:
    """The simulated world itself at its sketch views, cameras and depth as they are: nothing photographed, nothing learned."""
    import numpy as np

    from robot.world import World
    from scene.camera import View
    from scene.dataset import save_image, save_views
    from scene.views import depth_path

    views = []
    with World.from_spec(job.settings("world")) as world:
        for name, camera in _setting(job, "scene.views")([], world.spec["sketch_views"], orbit=0).sketch.items():
            image, depth = world.photograph_with_depth(camera)
            save_image(out / "views" / f"{name}.png", image)
            np.save(depth_path(out / "views", name), depth.astype(np.float32))
            views.append(View(name, camera, image))
    save_views(out / "views", views, images=".", frame={"name": "robot base", "unit": "metre"})
    return {"views": len(views)}


def sketch(job: Job, out: Path) -> dict:
    """A person, or the scripted one, draws the motion on two views, or one along a surface; on a third for evaluation only."""
    import numpy as np

    from teach import sketch as sketch_files

    if job.cfg.user.kind == "files":
        sketches = sketch_files.load(_stored_sketches(job, job.cfg.user.file))
        held_out, intended = [], {}
    elif job.cfg.user.kind == "page":
        from conf.page import draw_by_hand

        name, sketches = draw_by_hand(job)
        held_out, intended = [], {}
        log.info("  the skill %s", name)
    else:
        from conf.seen import draw

        judge = job.cfg.user.held_out
        if judge not in DRAWN_ON:
            raise ValueError(f"user.held_out={judge}: the views to sketch on are {', '.join(DRAWN_ON)}")
        drawn, paths = draw(job, [*(name for name in DRAWN_ON if name != judge), judge])
        sketches, held_out, intended = drawn[:-1], drawn[-1:], {"training": paths[:-1], "held_out": paths[-1]}
    sketch_files.check(sketches, surfaces=_depths(job, sketches))
    sketch_files.save(out / "sketches.json", sketches)
    sketch_files.save(out / "held_out.json", held_out)
    np.savez(out / "intended.npz", **intended)
    strokes = sum(len(s.strokes) for s in sketches)
    log.info("  %d strokes on %s", strokes, ", ".join(s.view for s in sketches))
    return {"strokes": strokes, "views": len(sketches)}


def fit(job: Job, out: Path) -> dict:
    """RPTL: strokes become a distribution of 3D trajectories."""
    import numpy as np

    from conf.evaluation import taught_errors
    from teach import sketch as sketch_files
    from teach.density import over_picture

    sketches = sketch_files.load(job.run / "sketches.json")
    parts = {part: _setting(job, f"teach.{part}") for part in ("density", "raytrace", "basis")}
    pictures = {}
    picture = lambda sketch, p: pictures.setdefault(sketch.view, over_picture(p, (sketch.camera.width, sketch.camera.height)))
    skill = _setting(job, "teach.rptl")(sketches, seed=job.cfg.seed, depths=_depths(job, sketches), seen=picture, **parts)
    skill.save(out / "skill.npz")
    np.savez_compressed(out / "densities.npz", **pictures)
    metrics = {"seconds": skill.report["seconds"], "reprojection_px": skill.report["reprojection_px"]}
    metrics |= taught_errors(skill, job.run, seed=job.cfg.seed)
    if "mfd" in metrics:
        log.info("  in the held-out view: mean Frechet %(mfd).4f (oracle %(oracle_mfd).4f), Wasserstein %(wd).4f (oracle %(oracle_wd).4f)"
                 " of the picture's width", metrics)  # fmt: skip
    for name, litres in skill.report.get("keep_out", {}).items():
        log.info("  %s: %.2f litres", name, litres)
    if "sentence" in skill.report:
        log.info("  %s", skill.report["sentence"])
    for warning in skill.report.get("warnings", ()):
        log.warning("  note: %s", warning)
    return metrics


def plan(job: Job, out: Path) -> dict:
    """Samples are checked for reach and collision; the best feasible one is timed."""
    import numpy as np

    from robot.export import save_mcap
    from robot.world import World
    from teach.trajectory import Skill

    skill = Skill.load(job.run / "skill.npz")
    arm = _setting(job, "robot.arm")
    with World.from_spec(_obstacles(job, skill, arm)) as world:
        chosen = _setting(job, "robot.planner")(skill, arm, world.obstacles, start=arm.home, seed=job.cfg.seed)
    chosen.save(out / "plan.npz")
    write_json(out / "joint_trajectory.json", chosen.joint_trajectory())
    save_mcap(chosen, out / "plan.mcap")
    table = np.column_stack([chosen.times, chosen.joints, chosen.tip])
    np.savetxt(out / "trajectory.csv", table, "%.6f", ",", header=",".join(["time_s", *chosen.names, "x_m", "y_m", "z_m"]), comments="")
    log.info("  %s", chosen.sentence)
    return {
        "feasible": chosen.feasible,
        "samples": chosen.samples,
        "refused": len(chosen.refusals),
        "position_error_mm": 1000 * float(chosen.position_error.max()),
        "clearance_mm": 1000 * float(min(chosen.clearance.min(), chosen.self_clearance.min())),
        "duration_s": float(chosen.times[-1]),
    }


def _obstacles(job: Job, skill, arm) -> dict:
    """The world that planning knows: the world's file, or what the photographs show."""
    if not job.settings("robot.obstacles"):
        if job.cfg.photos:
            log.warning("  note: planned among the obstacles of world %s, not of the photographs; robot/obstacles=reconstruction does that", job.cfg.world.name)
        return job.settings("world")
    import numpy as np

    from robot.obstacles import on_the_arm
    from scene.space import Space

    start = arm.fk(arm.home)[:3, 3]
    paths = [way.distribution.mean_at(np.linspace(0, 1, 100)) for way in skill.starting_at(start)]
    space = Space.load(job.capture / "space.npz")
    spec = _setting(job, "robot.obstacles")(job.capture, space, np.concatenate(paths), on_the_arm(arm, arm.home))
    unseen = sum(thing["shape"] == "box" for thing in spec["objects"])
    log.info("  among %d pieces of the mesh and %d boxes of unseen space", len(spec["objects"]) - unseen, unseen)
    return spec


def execute(job: Job, out: Path) -> dict:
    """PyBullet performs the plan under motor control, the skill's events on the way; the world's own conditions judge it."""
    import numpy as np

    from robot.events import planned_events
    from robot.execution import save_video
    from robot.planner import Plan
    from robot.world import World
    from scene.dataset import save_image
    from teach.trajectory import Skill

    chosen = Plan.load(job.run / "plan.npz")
    if not chosen.feasible:
        raise ValueError(f"the plan is not feasible, so it is not performed: {chosen.sentence}")
    if job.cfg.photos:
        raise ValueError("there is no simulated world of your own photographs to perform in: plan.npz and joint_trajectory.json are the motion")
    spec = job.settings("world")
    with World.from_spec(spec) as world:
        events = planned_events(Skill.load(job.run / "skill.npz"), chosen)
        performed = _setting(job, "robot.execution")(chosen, _setting(job, "robot.arm"), world, events=events)
    performed.save(out / "execution.npz")
    save_video(out / "execution.mp4", performed.frames, performed.fps)
    save_image(out / "filmstrip.png", np.concatenate(performed.frames[performed.strip], axis=1))
    log.info("  %s", performed.sentence)
    return performed.metrics


SCENE = ("scene.seed",)
VIEWED = ("world.sketch_views", "world.seed", "world.variation", "world.view")
STAGES = (
    Stage("capture", capture, ("photos", "tags.json", "truth.json"), settings=("world", "robot.photographs", *SCENE), shared=True),
    Stage("reconstruct", reconstruct, ("images", "colmap", "sparse.ply", "transforms.json"),
          settings=("scene.colmap", "scene.frame", "scene.resection", *SCENE), inputs=lambda job: _fingerprint(job), shared=True),
    Stage("train", train, ("field.pt", "held_out"), ("reconstruct",), ("scene.fit", *SCENE), shared=True, resumable=True),
    Stage("surface", surface, ("mesh.ply", "mesh.png", "collision", "space.npz"), ("train",), ("scene.surface", *SCENE),
          shared=True, resumable=True),
    Stage("render", render, ("views",), ("train",), ("scene.views", "world.workspace", *VIEWED),
          inputs=lambda job: hashlib.sha256(file.read_bytes()).hexdigest() if (file := _drawn_before(job)) else None,
          shared=True, resumable=True),
    Stage("sketch", sketch, ("sketches.json", "held_out.json", "intended.npz"), ("render",), ("user", "world", "robot.arm", "seed"),
          inputs=lambda job: _asked(job)),
    Stage("fit", fit, ("skill.npz", "densities.npz"), ("sketch",), ("teach", "seed")),
    Stage("plan", plan, ("plan.npz", "trajectory.csv", "joint_trajectory.json", "plan.mcap"), ("fit",),
          ("robot.arm", "robot.planner", "robot.obstacles", "world", "seed"), inputs=lambda job: _pieces(job)),
    Stage("execute", execute, ("execution.npz", "execution.mp4", "filmstrip.png"), ("plan",), ("robot.arm", "robot.execution", "world")),
)  # fmt: skip
NAMES = tuple(stage.name for stage in STAGES)
TRUTH = Stage("render", true_views, ("views",), settings=("world", "scene.views"), shared=True)
"""Takes the place of all stages up to "render" where the scene is known from truth."""


def _stages(job: Job) -> tuple[Stage, ...]:
    return (TRUTH, *STAGES[NAMES.index("render") + 1 :]) if job.cfg.scene.truth else STAGES


def whole_job(job: Job) -> None:
    """Do the wanted stages in order; metrics.json is written after each of them, the report at the end."""
    wanted, records = _wanted(job), {}
    for stage in _stages(job):
        if stage.name not in wanted:
            _take_over(stage, job, records)
        elif stage.name == "execute" and "plan" in records and not records["plan"].metrics["feasible"] and len(wanted) > 1:
            log.warning("execute\n  left out: there is no feasible plan")
        else:
            _do(stage, job, records)
        if stage.name == "render" and "render" in wanted and job.settings("scene.paths"):
            from conf.rendering import render_path

            film = render_path(job, partial(_progress, title="path"))
            log.info("  %(frames)d frames along the path, %(rendered)d rendered now: %(folder)s", film)
    if "report" in wanted:
        from conf.report import write_report

        log.info("report\n  %s", write_report(job))


def _do(stage: Stage, job: Job, records: dict[str, Record]) -> None:
    stage = replace(stage, needs=_needs(stage, job))
    missing = [need for need in stage.needs if need not in records]
    if missing:
        raise FileNotFoundError(f"{stage.name} needs the files of {missing[0]}: say stages=[{missing[0]},{stage.name}]")
    log.info("%s", stage.name)
    records[stage.name] = record = stages.run(stage, job, records)
    log.info("  done in %.1f s%s", record.seconds, " (earlier; nothing it rests on has changed)" if record.reused else "")
    write_json(job.run / "metrics.json", _metrics(records))


def _needs(stage: Stage, job: Job) -> tuple[str, ...]:
    """The stages whose files a stage reads: no field is needed to sketch on photographs."""
    on_photographs = stage.name == "sketch" and job.cfg.user.kind == "files" and job.cfg.user.draws_on == "photographs"
    return ("reconstruct",) if on_photographs else stage.needs


def _take_over(stage: Stage, job: Job, records: dict[str, Record]) -> None:
    """A stage that is not to be done: its files are those of the job that is repeated, or of the newest run that has them."""
    found = stages.find(stage, stage.folder(job))
    if found is None and not stage.shared and job.cfg.rerun:
        found = stages.take(stage, Path(job.cfg.rerun), job)
    elif found is None and not stage.shared:
        found = stages.adopt(stage, job, lambda state, record: True)
    if found is not None:
        records[stage.name] = found


def _wanted(job: Job) -> list[str]:
    known = (*(stage.name for stage in _stages(job)), "report")
    if job.cfg.photos and job.cfg.scene.truth:
        raise ValueError("scene.truth is of simulated worlds: nobody knows it of photographs")
    if job.cfg.stages is None:
        if not job.cfg.photos:
            usual = [name for name in known if name != "surface"]
        else:
            usual = ["reconstruct", "train", "render", *(("sketch", "fit") if job.cfg.user.kind == "page" else ())]
        return usual + ["surface"] * bool(job.settings("robot.obstacles"))
    unknown = [name for name in job.cfg.stages if name not in known]
    if unknown or not job.cfg.stages:
        raise ValueError(f"unknown stage {', '.join(unknown) or '(none given)'}; there are {', '.join(known)}")
    if job.cfg.photos and "capture" in job.cfg.stages:
        raise ValueError("photos= gives the photographs, so there is nothing to capture: leave capture out of stages=")
    return list(job.cfg.stages)


def _metrics(records: dict[str, Record]) -> dict:
    """metrics.json: one group for each stage; total_seconds is what all of them cost, when they were done."""
    groups = {"train": "field", "fit": "teach"}
    metrics = {groups.get(name, name): {"seconds": r.seconds} | r.metrics for name, r in records.items()}
    return metrics | {"total_seconds": sum(record.seconds for record in records.values())}


def _setting(job: Job, key: str):
    """What a config group stands for: an object, or a function that waits for its arguments."""
    from omegaconf import OmegaConf

    return instantiate(OmegaConf.select(job.cfg, key), _convert_="all")


def _varied_world(job: Job) -> dict:
    """The world's data as it is built, under its seed."""
    from robot.variation import varied

    return varied(job.settings("world"))


def _photographs(job: Job) -> Path:
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


def _fingerprint(job: Job) -> dict[str, str]:
    """Names and contents of what is reconstructed and of its frame, so that other photographs are another scene."""
    from scene.frame import choose

    source = recognise(_photographs(job)) if job.cfg.photos or _photographs(job).exists() else None
    files = {os.path.relpath(path, source.folder): path for path in source.files()} if source else {}
    _, chosen, others = choose(_beside(job), job.cfg.scene.frame.method, job.cfg.scene.frame.file)
    for path in (*([chosen] if chosen else []), *others):
        inside = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path] * path.exists()
        files |= {one.name: one for one in inside}
    went_in = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    return went_in | ({"scene.video": str(job.settings("scene.video"))} if source and source.kind == "video" else {})


def _pieces(job: Job) -> str | None:
    """The contents of what planning knows of space, if that is the reconstruction."""
    if not job.settings("robot.obstacles"):
        return None
    files = [job.capture / "space.npz", *sorted((job.capture / "collision").glob("*.obj"))]
    if len(files) == 1 or not files[0].is_file():
        raise FileNotFoundError(f"robot/obstacles=reconstruction needs the mesh of {job.capture}: say stages=[surface,plan]")
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _stored_sketches(job: Job, name: str) -> Path:
    """A name in the capture's sketches folder, or a path."""
    folder = job.capture / "sketches"
    for path in (folder / f"{name}.json", folder / name, Path(name)):
        if path.is_file():
            return path
    there = ", ".join(sorted(path.stem for path in folder.glob("*.json"))) or "none"
    raise FileNotFoundError(f"there are no sketches {name!r}: give the path of a file, or a name in {folder} ({there})")


def _drawn_before(job: Job) -> Path | None:
    """scene.views.sketch: what was drawn before the next view is chosen."""
    from omegaconf import OmegaConf

    if missing := OmegaConf.missing_keys(job.cfg.scene.views):
        raise ValueError(f"these views need {missing.pop()}=...: a name in {job.capture / 'sketches'}, or a file")
    name = job.settings("scene.views.sketch")
    return _stored_sketches(job, name) if name else None


def _asked(job: Job) -> int | None:
    """A person is asked anew each time; what the others draw follows from settings."""
    return time.time_ns() if job.cfg.user.kind == "page" else None


def _depths(job: Job, sketches) -> dict:
    """Depth pictures of the sketched views, by name, as far as they were rendered."""
    from scene.views import load_depths

    return load_depths(job.capture / "views", {sketch.view: sketch.camera for sketch in sketches})


def _plain_camera(camera) -> dict:
    return {"K": camera.K.tolist(), "world_from_camera": camera.world_from_camera.tolist(),
            "width": camera.width, "height": camera.height}  # fmt: skip


def _progress(items, title: str):
    from tqdm import tqdm

    return tqdm(items, desc=f"  {title}", leave=False, disable=not _watched())


def _watched() -> bool:
    """Progress bars are for people, not for log files."""
    return sys.stderr.isatty()


def main(*overrides: str) -> None:
    """The console script scene2skill."""
    sys.exit(launch(whole_job, *overrides))


if __name__ == "__main__":
    main()
