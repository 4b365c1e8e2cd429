"""A sweep is one folder of jobs: stopped, the same command goes on with it; ended, it has its table.

    runs/<experiment>/<time>/ sweep.json 0/ 1/ ... table.md results.csv report.html

A job is finished when its status.json says so with the same settings, and is then not run again: of a sweep that was
stopped, whose jobs failed or lost their folders, only what is missing is run. The folder is locked while a sweep runs in
it, so that two of the same command do not share it. state in sweep.json: running; stopped before its last job; failed,
some of its jobs; finished.
"""

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout
from omegaconf import DictConfig, OmegaConf

from conf.results import JobResult, collect, sweep_of
from conf.stages import status_of, write_json

QUESTIONS = {"--cfg", "-c", "--info", "-i", "--help", "-h", "--hydra-help", "--version"}
"""Options with which Hydra answers, and runs nothing."""


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
        if not {"-m", "--multirun"} & set(arguments) or QUESTIONS & set(arguments):
            return None
        key = {"arguments": arguments, "git": commit()}
        folder = _chosen(arguments, key) or _unfinished(key) or _new(arguments)
        folder.mkdir(parents=True, exist_ok=True)
        lock = _lock(folder)
        if lock is None:
            raise ValueError(f"a sweep runs in {folder} already: wait for it, or choose another hydra.sweep.dir")
        write_json(folder / "sweep.json", {"key": key, "state": "running"})
        return cls(folder, lock)

    def end(self, whole: bool) -> int:
        """Write the table; the exit code: 0 if every job finished, else 2. whole: whether the last job was reached."""
        from conf import gallery

        if not any(self.folder.glob("*/status.json")):  # no job began: the command line was wrong
            self._leave_nothing()
            return 0
        known = sweep_of(self.folder) | {"state": "failed" if whole else "stopped"}
        write_json(self.folder / "sweep.json", known)
        results = collect([self.folder])
        for said in _alike(results.missing):
            print(said, file=sys.stderr)
        print(gallery.write(results, self.folder))
        if results.missing and whole:
            print("the same command does what is missing again, and keeps the finished jobs", file=sys.stderr)
        elif whole:
            write_json(self.folder / "sweep.json", known | {"state": "finished", "jobs": len(results.jobs)})
        self.lock.release()
        return 2 if results.missing else 0

    def _leave_nothing(self) -> None:
        self.lock.release()
        for ours in ("sweep.json", ".lock"):
            (self.folder / ours).unlink(missing_ok=True)
        with suppress(OSError):  # what others put there stays
            self.folder.rmdir()
            self.folder.parent.rmdir()


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


def _chosen(arguments: list[str], key: dict) -> Path | None:
    """The folder that hydra.sweep.dir names. Raises ValueError where something else lies there, which jobs would overwrite."""
    chosen = [a.partition("=")[2].strip("'\"") for a in arguments if a.startswith("hydra.sweep.dir=")]
    if not chosen:
        return None
    folder = Path(chosen[-1]).resolve()
    if (folder / "sweep.json").exists():
        there = _asked(sweep_of(folder).get("key", {}))
        if there != _asked(key):
            raise ValueError(f"{folder} holds the sweep of {' '.join(sorted(there)) or 'the shipped settings'}, whose jobs these would overwrite: "
                             "choose another hydra.sweep.dir")  # fmt: skip
    elif folder.exists() and not folder.is_dir() or any(folder.glob("[!.]*")):
        raise ValueError(f"{folder} is no folder of a sweep and not empty: choose another hydra.sweep.dir")
    return folder


def _asked(key: dict) -> set[str]:
    """What a command line asks of each job: without what says where and how jobs are run."""
    return {argument for argument in key.get("arguments", ()) if not argument.startswith(("-", "hydra.", "hydra/"))}


def _unfinished(key: dict) -> Path | None:
    """The newest sweep of this command, if some of its jobs did not finish, nobody runs it now and the code is the same."""
    for path in sorted(Path("runs").glob("*/*/sweep.json"), key=lambda path: path.stat().st_mtime, reverse=True):
        begun = sweep_of(path.parent)
        if begun.get("key", {}).get("arguments") == key["arguments"]:
            lock = None if _is_whole(path.parent, begun) else _lock(path.parent)
            if lock is None:
                return None
            lock.release()
            if begun["key"] != key:
                print(f"{path.parent} has jobs that did not finish, of other code: hydra.sweep.dir={path.parent} goes on with it. A new one begins")
                return None
            print(f"going on with {path.parent}: finished jobs are kept (move it away to begin anew)")
            return path.parent.resolve()
    return None


def _is_whole(folder: Path, begun: dict) -> bool:
    """Whether all jobs of a sweep finished, and their folders are still there."""
    finished = [path for path in folder.glob("*/status.json") if status_of(path.parent).get("state") == "finished"]
    return begun.get("state") == "finished" and len(finished) >= begun.get("jobs", 0)


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
