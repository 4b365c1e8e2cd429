"""Stages that make the motion: sketches -> skill -> plan -> performance.

Each function reads the files of the stages before, calls one room of the house, writes its own files into ``out`` and
returns what it measured.
"""

import hashlib
import logging
import time
from pathlib import Path

from conf.scene_stages import stored_sketches
from conf.stages import Job, setting, write_json

log = logging.getLogger("scene2skill")


def sketch(job: Job, out: Path) -> dict:
    """A person, or the scripted one, draws the motion on two views or more, or one along a surface; on another for evaluation only."""
    import numpy as np

    from teach import sketch as sketch_files

    if job.cfg.user.kind == "files":
        sketches = sketch_files.load(stored_sketches(job, job.cfg.user.file))
        held_out, intended = [], {}
    elif job.cfg.user.kind == "page":
        from conf.page import draw_by_hand

        name, sketches = draw_by_hand(job)
        held_out, intended = [], {}
        log.info("  the skill %s", name)
    else:
        from conf.seen import draw, drawn_on, roles

        teaching, judging = roles(drawn_on(job), job.cfg.user.held_out)
        drawn, paths, meant = draw(job, [*teaching, *judging])
        sketches, held_out = drawn[: len(teaching)], drawn[len(teaching) :]
        intended = {"training": paths[: len(teaching)], "meant": meant}
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
    parts = {part: setting(job, f"teach.{part}") for part in ("density", "raytrace", "basis")}
    pictures = {}
    picture = lambda sketch, p: pictures.setdefault(sketch.view, over_picture(p, (sketch.camera.width, sketch.camera.height)))
    skill = setting(job, "teach.rptl")(sketches, seed=job.cfg.seed, depths=_depths(job, sketches), seen=picture, **parts)
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
    from robot.mounting import mounted
    from robot.world import World
    from teach.trajectory import Skill

    skill = Skill.load(job.run / "skill.npz")
    spec, arm = mounted(job.settings("world"), setting(job, "robot.arm"))
    with World.from_spec(_obstacles(job, skill, spec, arm, out / "cut"), textured=False) as world:
        world.bring_held(arm, arm.home)
        chosen = setting(job, "robot.planner")(skill, arm, world.obstacles, start=arm.home, seed=job.cfg.seed)
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


def _obstacles(job: Job, skill, world: dict, arm, work: Path) -> dict:
    """The world that planning knows: the world's file, or what the photographs show. work: a folder for pieces of that."""
    if not job.settings("robot.obstacles"):
        if job.cfg.photos:
            log.warning("  note: planned among the obstacles of world %s, not of the photographs; robot/obstacles=reconstruction does that", job.cfg.world.name)
        return world
    import numpy as np

    from robot.obstacles import around, on_the_arm
    from robot.variation import varied
    from scene.surface.space import Space

    start = arm.fk(arm.home)[:3, 3]
    paths = [way.distribution.mean_at(np.linspace(0, 1, 100)) for way in skill.starting_at(start)]
    space = Space.load(job.capture / "space.npz")
    touch = job.settings("robot.obstacles")["touch"]
    if touch is None:
        meant = [] if job.cfg.photos else world.get("touch", [])
        touch = around(thing for thing in varied(world)["objects"] if thing["name"] in meant)
    spec = setting(job, "robot.obstacles")(job.capture, space, np.concatenate(paths), on_the_arm(arm, arm.home), touch=touch, work=work)
    if touch:
        log.info("  the hand may touch what lies in the box%s of %s", "es" * (len(touch) > 1), ", ".join(box["name"] for box in touch))
    unseen = sum(thing["shape"] == "box" for thing in spec["objects"])
    log.info("  among %d pieces of the mesh and %d boxes of unseen space", len(spec["objects"]) - unseen, unseen)
    return spec | ({"held": world["held"]} if world.get("held") else {})


def execute(job: Job, out: Path) -> dict:
    """PyBullet performs the plan under motor control, the skill's events on the way; the world's own conditions judge it."""
    import numpy as np

    from robot.events import planned_events
    from robot.execution import save_video
    from robot.mounting import mounted
    from robot.planner import Plan
    from robot.world import World
    from scene.dataset import save_image
    from teach.trajectory import Skill

    chosen = Plan.load(job.run / "plan.npz")
    if not chosen.feasible:
        raise ValueError(f"the plan is not feasible, so it is not performed: {chosen.sentence}")
    if job.cfg.photos:
        raise ValueError("there is no simulated world of your own photographs to perform in: plan.npz and joint_trajectory.json are the motion")
    spec, arm = mounted(job.settings("world"), setting(job, "robot.arm"))
    with World.from_spec(spec) as world:
        events = planned_events(Skill.load(job.run / "skill.npz"), chosen)
        performed = setting(job, "robot.execution")(chosen, arm, world, events=events)
    performed.save(out / "execution.npz")
    save_video(out / "execution.mp4", performed.frames, performed.fps)
    save_image(out / "filmstrip.png", np.concatenate(performed.frames[performed.strip], axis=1))
    log.info("  %s", performed.sentence)
    return performed.metrics | _letter(job, spec, performed, chosen)


def _letter(job: Job, spec: dict, performed, chosen) -> dict:
    """How well the world's letter was written, if its motion is one and a scripted user meant it."""
    import numpy as np

    from robot.variation import varied

    motion = varied(spec).get("motion") or {}
    if not motion.get("letter") or job.cfg.user.kind != "scripted":
        return {}
    from conf.writing import written

    with np.load(job.run / "intended.npz") as paths:
        meant = paths["training"].reshape(-1, *paths["training"].shape[2:])
    rated = written(motion, performed.tip, chosen.tip, meant)
    log.info("  the letter %(letter)s looks like %(looks_like)s; %(to_intended_mm).0f mm from the intended one (oracle %(oracle_to_intended_mm).0f mm)", rated)
    return {"letter": rated}


def asked(job: Job) -> int | str | None:
    """A person is asked anew each time, a file may have been changed; what the scripted user draws follows from settings."""
    if job.cfg.user.kind == "files":
        return hashlib.sha256(stored_sketches(job, job.cfg.user.file).read_bytes()).hexdigest()
    return time.time_ns() if job.cfg.user.kind == "page" else None


def pieces(job: Job) -> str | None:
    """The contents of what planning knows of space, if that is the reconstruction."""
    if not job.settings("robot.obstacles"):
        return None
    files = [job.capture / "space.npz", *sorted((job.capture / "collision").glob("*.obj"))]
    if len(files) == 1 or not files[0].is_file():
        raise FileNotFoundError(f"robot/obstacles=reconstruction needs the mesh of {job.capture}: say stages=[surface,plan]")
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _depths(job: Job, sketches) -> dict:
    """Depth pictures of the sketched views, by name, as far as they were rendered."""
    from scene.views import load_depths

    return load_depths(job.capture / "views", {sketch.view: sketch.camera for sketch in sketches})
