"""A sweep is one folder of jobs: stopped, the same command goes on with it; ended, it has its table.

    runs/<experiment>/<time>/ sweep.json 0/ 1/ ... table.md results.csv report.html

A job is finished when its status.json says so with the same settings, and is then not run again. The folder is
locked while a sweep runs in it, so that two of the same command do not share it.
"""

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout
from omegaconf import DictConfig, OmegaConf

from conf.results import JobResult, collect
from conf.stages import status_of, write_json
from scene.files import read_json


@dataclass(frozen=True)
class Sweep:
    """A folder of jobs that this process runs."""

    folder: Path
    lock: FileLock

    @classmethod
    def begin(cls, arguments: list[str], commit: Callable[[], str | None]) -> "Sweep | None":
        """The sweep that this command line starts or goes on with; None where it asks for a single job.

        commit(): of the code; other code begins anew, since results of both do not belong in one table.
        """
        if not {"-m", "--multirun"} & set(arguments):
            return None
        key = {"arguments": arguments, "git": commit()}
        folder = _chosen(arguments) or _unfinished(key) or _new(arguments)
        folder.mkdir(parents=True, exist_ok=True)
        lock = _lock(folder)
        if lock is None:
            raise ValueError(f"a sweep runs in {folder} already: wait for it, or choose another hydra.sweep.dir")
        write_json(folder / "sweep.json", {"key": key, "state": "running"})
        return cls(folder, lock)

    def end(self) -> int:
        """Write the table; the exit code: 0 if every job finished, else 2."""
        from conf import gallery

        missing, begun = None, json.loads((self.folder / "sweep.json").read_text())
        if any(self.folder.glob("*/status.json")):
            results = collect([self.folder])
            missing = results.missing
            for said in _alike(missing):
                print(said, file=sys.stderr)
            print(gallery.write(results, self.folder))
        write_json(self.folder / "sweep.json", begun | {"state": "finished" if missing == [] else "stopped"})
        self.lock.release()
        return 2 if missing else 0


def settings_key(cfg: DictConfig) -> str:
    """What a finished job is recognised by: all of its settings."""
    plain = OmegaConf.to_container(cfg, resolve=True)
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def is_finished(run_folder: Path, settings: str) -> bool:
    """Whether the job of this folder came to its end with these settings."""
    status = status_of(run_folder)
    return status.get("state") == "finished" and status.get("settings") == settings


def kills_of(run_folder: Path, settings: str) -> int:
    """How often this job was killed in a row, with these settings."""
    status = status_of(run_folder)
    return status.get("kills", 0) + 1 if status.get("state") == "running" and status.get("settings") == settings else 0


def _alike(missing: Sequence[JobResult]) -> Iterable[str]:
    """A line for all jobs that failed alike."""
    groups: dict[tuple[str, str], list[str]] = {}
    for job in missing:
        groups.setdefault((job.state, job.error), []).append(job.folder.name)
    for (state, error), names in groups.items():
        yield f"job{'s' * (len(names) > 1)} {', '.join(names)} {state}: {error}"


def _chosen(arguments: list[str]) -> Path | None:
    chosen = [a.partition("=")[2].strip("'\"") for a in arguments if a.startswith("hydra.sweep.dir=")]
    return Path(chosen[-1]).resolve() if chosen else None


def _unfinished(key: dict) -> Path | None:
    """The newest sweep of this key, if some of its jobs did not finish and nobody runs it now."""
    for path in sorted(Path("runs").glob("*/*/sweep.json"), key=lambda path: path.stat().st_mtime, reverse=True):
        begun = read_json(path, "")
        if begun.get("key") == key:
            lock = None if begun["state"] == "finished" else _lock(path.parent)
            if lock is None:
                return None
            lock.release()
            print(f"going on with {path.parent}: finished jobs are kept (move it away to begin anew)")
            return path.parent.resolve()
    return None


def _new(arguments: list[str]) -> Path:
    names = [a.partition("=")[2] for a in arguments if a.startswith("experiment=")] or ["default"]
    return Path("runs", names[-1], time.strftime("%Y-%m-%d_%H-%M-%S")).resolve()


def _lock(folder: Path) -> FileLock | None:
    """The lock of a sweep's folder, taken; None where another process has it."""
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return lock
