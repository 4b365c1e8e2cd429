"""Hydra's main, and what every job gets: provenance, a status, one clear error instead of a traceback."""

import json
import logging
import os
import platform
import subprocess
import sys
import time
import traceback
from functools import cache
from importlib.metadata import version
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from conf import rerun
from conf.mistakes import check_experiment, check_launcher, check_seeds, explained, was_killed
from conf.results import figures_of
from conf.stages import Job, write_json
from conf.sweep import Sweep, is_finished, kills_of, settings_key
from scene.inputs import scene_name

log = logging.getLogger("scene2skill")

BESIDE = ("paths", "film", "surface")
"""Groups of scene that a capture folder does not depend on: what they make lies beside the rest, and nothing is made of it."""

USER_ERRORS = (ValueError, OSError, HydraException, OmegaConfBaseException)
VERSIONS = ("scene2skill", "torch", "numpy", "pycolmap", "pybullet", "numba", "zuko", "toppra", "hydra-core")


def launch(task, *overrides: str) -> int:
    """Compose the config from the command line, run ``task(job)`` for each job, return the exit code.

    0 done; 2 the input was at fault (one line says how); 130 interrupted; anything else is a defect and keeps
    its traceback.
    """
    OmegaConf.register_new_resolver("groups", _groups, replace=True)
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises instead of printing its own traceback

    @hydra.main(version_base="1.3", config_path="pkg://conf", config_name="config")
    def hydra_main(cfg: DictConfig) -> float | None:
        return _run_job(task, cfg)

    sys.argv[1:1] = overrides
    sweep, whole = None, False
    try:
        check_launcher(sys.argv[1:])
        check_experiment(sys.argv[1:])
        sys.argv[1:] = rerun.expanded(sys.argv[1:])
        sweep = Sweep.begin(sys.argv[1:], lambda: _git("rev-parse", "HEAD"))
        if sweep is not None:
            sys.argv.append(f"hydra.sweep.dir='{sweep.folder}'")
        hydra_main()
        whole = True
    except KeyboardInterrupt:
        print("\nInterrupted. Finished stages are kept: the same command goes on from there.", file=sys.stderr)
        return 130
    except USER_ERRORS as error:
        return _report(error)
    except Exception as error:
        if not was_killed(error):
            raise
        return _report(MemoryError("the process of a job was killed, perhaps for want of memory; the same command goes on from there"))
    finally:
        failed = sweep.end(whole) if sweep is not None else 0
    return failed


def _groups() -> str:
    """The config groups and their options for --help; Hydra's own list takes it a second."""
    root = Path(__file__).parent
    options: dict[str, list[str]] = {}
    for path in sorted(root.rglob("*.yaml")):
        name = path.relative_to(root).with_suffix("").as_posix()
        group = "experiment" if name.startswith("experiment/") else path.parent.relative_to(root).as_posix()
        if group != "." and not group.startswith("hydra"):
            options.setdefault(group, []).append(name.removeprefix(f"{group}/"))
    return "\n".join(f"{group}: {', '.join(names)}" for group, names in options.items())


def _run_job(task, cfg: DictConfig):
    run_folder, one_of_many = Path(HydraConfig.get().runtime.output_dir), HydraConfig.get().mode == RunMode.MULTIRUN
    job = Job(cfg, capture_folder(cfg), run_folder)
    settings = settings_key(cfg)
    kills = kills_of(run_folder, settings)
    if one_of_many:
        log.info("job %s: %s", run_folder.name, " ".join(HydraConfig.get().overrides.task))
        if is_finished(run_folder, settings):
            log.info("  finished earlier")
            return _objective(job)
        if kills:
            log.warning("  was killed when it ran last, perhaps for want of memory: %s", "once more" if kills == 1 else "left out, as the time before")
    elif swept := HydraConfig.get().sweeper.get("params"):
        log.info("note: experiment=%s sweeps over %s: this is one job of it, -m does all", HydraConfig.get().runtime.choices.experiment,
                 ", ".join(key.lstrip("+") for key in swept))  # fmt: skip
    status = {"state": "running", "capture": str(job.capture), "settings": settings, "started": time.strftime("%Y-%m-%dT%H:%M:%S")}
    write_json(run_folder / "status.json", status | {"kills": kills})
    write_json(run_folder / "provenance.json", provenance())
    started = time.perf_counter()
    try:
        check_seeds(cfg)
        if one_of_many and kills > 1:  # a third time would keep the jobs behind it from ever running
            raise MemoryError(f"it was killed {kills} times while it ran, perhaps for want of memory")
        track = instantiate(cfg.get("tracking"))
        task(job)
        status["state"] = "finished"
        _look_back(job, track)
    except KeyboardInterrupt:
        status["state"] = "interrupted"
        raise
    except Exception as error:
        status |= {"state": "failed", "error": explained(error), "traceback": traceback.format_exc()}
        if one_of_many:  # the others go on; the sweep's end names it
            return float("nan")
        if isinstance(error, USER_ERRORS):
            raise SystemExit(_report(error)) from None
        raise
    finally:
        status["seconds"] = round(time.perf_counter() - started, 3)
        write_json(run_folder / "status.json", status)
    return _objective(job)


def _look_back(job: Job, track) -> None:
    """What is done with the figures of a finished job: tracked, and compared with those of the job it repeats."""
    if track is not None:
        track(OmegaConf.to_container(job.cfg, resolve=True), figures_of(job.run), job.run)
    for said in rerun.verdict(job.run, Path(job.cfg.rerun)) if job.cfg.rerun else ():
        log.info("%s", said)


def _objective(job: Job) -> float | None:
    """The figure that a sweeper such as optuna makes small: experiment.objective, a path in metrics.json."""
    if job.cfg.experiment.objective is None:
        return None
    return float(figures_of(job.run)[job.cfg.experiment.objective])


def _report(error: Exception) -> int:
    print(f"error: {explained(error, sys.argv[1:])}", file=sys.stderr)
    return 2


def capture_folder(cfg: DictConfig) -> Path:
    """Where the scene of this job lies: ``data=`` if it is given, else data/<photographs or world>.

    Scene settings other than the shipped ones get a folder of their own (a hash behind the name), so that jobs of
    a sweep over them do not overwrite each other.
    """
    if cfg.data:
        return Path(cfg.data).resolve()
    name = scene_name(cfg.photos) if cfg.photos else cfg.world.name
    key = _scene_key(cfg)
    return Path("data", name if key == _shipped_key(HydraConfig.get().runtime.choices.world) else f"{name}-{key:08x}").resolve()


@cache
def _shipped_key(world: str) -> int:
    return _scene_key(hydra.compose("config", overrides=[f"world={world}"]))


def _scene_key(cfg: DictConfig) -> int:
    import zlib

    parts = {"world": cfg.world, "photographs": cfg.robot.photographs, "scene": cfg.scene}
    plain = {name: OmegaConf.to_container(node, resolve=True) for name, node in parts.items()}
    plain["scene"] = {name: part for name, part in plain["scene"].items() if name not in BESIDE}
    return zlib.crc32(json.dumps(plain, sort_keys=True).encode())


def provenance() -> dict:
    """What is needed to say later where a result came from."""
    return {
        "argv": sys.argv,
        "git": _git("rev-parse", "HEAD"),
        "dirty": bool(_git("status", "--porcelain")),
        "versions": {name: version(name) for name in VERSIONS},
        "python": platform.python_version(),
        "host": platform.node(),
        "cpus": os.cpu_count(),
    }


@cache
def _git(*arguments: str) -> str | None:
    """What git says of the code as this process loaded it: asked once."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return None
    return subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True).stdout.strip()
