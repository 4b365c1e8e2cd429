"""The whole job: photographs -> cameras -> field -> views -> sketches -> skill -> plan -> motion -> report.

    scene2skill                            the whole job on the embedded world
    scene2skill -m seed=0,1,2              a sweep; the scene is built once
    python -m conf.pipeline stages=[fit]   one stage on the files of the one before (also: python -m teach.fit)
"""

import logging
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

from conf import motion_stages, scene_stages, stages
from conf.run import launch
from conf.stages import Job, Record, Stage, progress, write_json

log = logging.getLogger("scene2skill")

SCENE = ("scene.seed",)
PHOTOGRAPHED = tuple(f"world.{key}" for key in ("name", "seed", "variation", "objects", "joints", "held", "tags", "view", "goal"))
VIEWED = ("world.sketch_views", "world.seed", "world.variation", "world.view")
STAGES = (
    Stage("capture", scene_stages.capture, ("photos", "tags.json", "truth.json"), settings=(*PHOTOGRAPHED, "robot.photographs", *SCENE), shared=True),
    Stage("reconstruct", scene_stages.reconstruct, ("images", "colmap", "sparse.ply", "transforms.json"),
          settings=("scene.colmap", "scene.frame", "scene.resection", *SCENE), inputs=scene_stages.fingerprint, shared=True),
    Stage("train", scene_stages.train, ("field.pt", "held_out", "moved"), ("reconstruct",), ("scene.fit", *SCENE), shared=True, resumable=True),
    Stage("surface", scene_stages.surface, ("mesh.ply", "mesh.png", "collision", "space.npz"), ("train",), ("scene.surface", *SCENE),
          shared=True, resumable=True),
    Stage("render", scene_stages.render, ("views",), ("train",), ("scene.views", "world.workspace", *VIEWED),
          inputs=scene_stages.drawn_before, shared=True, resumable=True),
    Stage("sketch", motion_stages.sketch, ("sketches.json", "held_out.json", "intended.npz"), ("render",), ("user", "world", "robot.arm", "seed"),
          inputs=motion_stages.asked),
    Stage("fit", motion_stages.fit, ("skill.npz", "densities.npz"), ("sketch",), ("teach", "seed")),
    Stage("plan", motion_stages.plan, ("plan.npz", "trajectory.csv", "joint_trajectory.json", "plan.mcap"), ("fit",),
          ("robot.arm", "robot.planner", "robot.obstacles", "world", "seed"), inputs=motion_stages.pieces),
    Stage("execute", motion_stages.execute, ("execution.npz", "execution.mp4", "filmstrip.png"), ("plan",), ("robot.arm", "robot.execution", "world")),
)  # fmt: skip
NAMES = tuple(stage.name for stage in STAGES)
TRUTH = Stage("render", scene_stages.true_views, ("views",), settings=("world", "scene.views"), shared=True)
"""Takes the place of all stages up to "render" where the scene is known from truth."""


def _stages(job: Job) -> tuple[Stage, ...]:
    return (TRUTH, *STAGES[NAMES.index("render") + 1 :]) if job.cfg.scene.truth else STAGES


def whole_job(job: Job) -> None:
    """Do the wanted stages in order; metrics.json is written after each of them, the report at the end."""
    wanted, records = _wanted(job), {}
    if any("robot.arm" in stage.settings for stage in _stages(job) if stage.name in wanted):
        stages.setting(job, "robot.arm")  # what is wrong with it is said before minutes are spent on the scene
    for stage in _stages(job):
        if stage.name not in wanted:
            _take_over(stage, job, records)
        elif stage.name == "execute" and "plan" in records and not records["plan"].metrics["feasible"] and len(wanted) > 1:
            log.warning("execute\n  left out: there is no feasible plan")
        else:
            _do(stage, job, records)
        if stage.name == "render" and "render" in wanted and job.settings("scene.paths"):
            from conf.rendering import render_path

            film = render_path(job, partial(progress, title="path"))
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
    on_photographs = stage.name == "sketch" and job.cfg.user.get("draws_on") == "photographs"
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
    sizes = lambda record: {name: mb for name in ("peak_mb", "disk_mb") if (mb := getattr(record, name)) is not None}
    metrics = {groups.get(name, name): {"seconds": r.seconds} | sizes(r) | r.metrics for name, r in records.items()}
    return metrics | {"total_seconds": sum(record.seconds for record in records.values())}


def main(*overrides: str) -> None:
    """The console script scene2skill."""
    sys.exit(launch(whole_job, *overrides))


if __name__ == "__main__":
    main()
