"""A stage is done once: what went in is hashed, what came out is kept, and stages meet only in files.

Every stage writes into a folder of its own under ``.stages/`` and is moved into place when it is whole, so a
killed job leaves no half file and the next run goes on from the last finished stage. Stages of the scene lie in
the capture folder, which jobs share under a lock; the others lie in the run's folder.
"""

import hashlib
import json
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from filelock import FileLock, Timeout
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from scene.files import replacing


@dataclass(frozen=True)
class Job:
    """One job of Hydra: its settings, the capture folder it shares, the run folder it owns."""

    cfg: DictConfig
    capture: Path
    run: Path

    def settings(self, key: str):
        """The plain value of a setting; None where it is not set."""
        node = OmegaConf.select(self.cfg, key)
        return OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node


@dataclass(frozen=True)
class Stage:
    """One step of the whole job.

    build(job, folder) writes ``outputs`` into folder and returns its measurements. ``needs`` names the stages whose
    files it reads, ``settings`` the config keys that it depends on, ``inputs(job)`` what else went in (hashable as
    JSON). ``shared`` stages lie in the capture folder. ``resumable`` ones find their unfinished folder again.
    """

    name: str
    build: Callable[[Job, Path], dict]
    outputs: tuple[str, ...]
    needs: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    inputs: Callable[[Job], object] = lambda job: None
    shared: bool = False
    resumable: bool = False

    def folder(self, job: Job) -> Path:
        return job.capture if self.shared else job.run


@dataclass(frozen=True)
class Record:
    """What is kept of a finished stage. peak_mb: the most memory that its process had then; disk_mb: what it wrote."""

    hash: str
    metrics: dict
    seconds: float
    peak_mb: float | None = None
    disk_mb: float | None = None
    reused: bool = True


def run(stage: Stage, job: Job, needed: dict[str, Record]) -> Record:
    """Do the stage, unless it was done with the same settings on the same inputs."""
    folder, key = stage.folder(job), stage_hash(stage, job, needed)
    keep = folder / ".stages"
    keep.mkdir(parents=True, exist_ok=True)
    with FileLock(keep / f"{stage.name}.lock") if stage.shared else nullcontext():
        record = find(stage, folder)
        if record is not None and record.hash == key:
            return record
        if stage.shared:
            record = _from_beside(stage, job, key)
        elif record is None:
            record = adopt(stage, job, lambda status, found: status != "finished" and found.hash == key)
        if record is not None and record.hash == key:
            return record
        return _build(stage, job, key)


def _build(stage: Stage, job: Job, key: str) -> Record:
    keep = stage.folder(job) / ".stages"
    partial = keep / f"{stage.name}-{key[:12]}"
    for stale in keep.glob(f"{stage.name}-*"):
        if not (stage.resumable and stale == partial):
            shutil.rmtree(stale)
    partial.mkdir(exist_ok=True)
    _forget_peak()
    started = time.perf_counter()
    metrics = stage.build(job, partial)
    seconds = time.perf_counter() - started
    peak = _peak_mb()
    (keep / f"{stage.name}.json").unlink(missing_ok=True)
    disk = sum(_size_mb(partial / output) for output in stage.outputs)
    for output in stage.outputs:
        _move(partial / output, stage.folder(job) / output)
    shutil.rmtree(partial)
    record = {"hash": key, "metrics": metrics, "seconds": seconds, "peak_mb": peak, "disk_mb": disk}
    write_json(keep / f"{stage.name}.json", record | {"settings": {k: job.settings(k) for k in stage.settings}})
    return Record(key, metrics, seconds, peak, disk, reused=False)


def _forget_peak() -> None:
    """From here on the process's largest memory is counted anew, where the system can do that (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_mb() -> float:
    """The largest memory of this process [MB] since it was forgotten."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # bytes where there is no /proc (macOS)
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def _from_beside(stage: Stage, job: Job, key: str) -> Record | None:
    """The same stage of a scene beside this one, copied: scenes that differ in later settings share what comes before."""
    for path in sorted(job.capture.parent.glob(f"*/.stages/{stage.name}.json")):
        folder = path.parents[1]
        with suppress(Timeout, OSError), FileLock(path.with_suffix(".lock"), timeout=0):  # a held one is being built anew
            record = find(stage, folder) if folder != job.capture else None
            if record is not None and record.hash == key:
                return take(stage, folder, job)
    return None


def find(stage: Stage, folder: Path) -> Record | None:
    """The record of a finished stage whose outputs are all there."""
    path = folder / ".stages" / f"{stage.name}.json"
    if not path.exists() or not all((folder / output).exists() for output in stage.outputs):
        return None
    record = json.loads(path.read_text())
    return Record(record["hash"], record["metrics"], record["seconds"], record.get("peak_mb"), record.get("disk_mb"))


def adopt(stage: Stage, job: Job, wanted: Callable[[str, Record], bool]) -> Record | None:
    """Take a stage of the run folder over from the newest earlier run on the same capture that ``wanted`` accepts.

    ``wanted(state, record)`` is asked with the state of that run. Its files are copied: a run folder is whole.
    """
    others = (folder for folder in job.run.parents[1].iterdir() if folder != job.run.parent)  # a sweep of many jobs does not look through itself
    earlier = sorted((path for folder in others for path in folder.glob("*/status.json")), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in earlier:
        status = status_of(path.parent)
        if status.get("capture") != str(job.capture) or (record := find(stage, path.parent)) is None:
            continue
        if wanted(status["state"], record):
            return take(stage, path.parent, job)
    return None


def status_of(run: Path) -> dict:
    """What a run says of itself in status.json; nothing where there is none, or where the file is another's."""
    try:
        status = json.loads((run / "status.json").read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return {}
    return status if isinstance(status, dict) else {}


def take(stage: Stage, folder: Path, job: Job) -> Record | None:
    """Copy what a stage made in ``folder`` into the job's own; None where it was not done there."""
    record, own = find(stage, folder), stage.folder(job)
    if record is not None:
        (own / ".stages").mkdir(parents=True, exist_ok=True)
        for output in (*stage.outputs, f".stages/{stage.name}.json"):
            _copy(folder / output, own / output)
    return record


def stage_hash(stage: Stage, job: Job, needed: dict[str, Record]) -> str:
    """What went in: the settings, the stages before, the inputs and the version of the code."""
    went_in = {
        "stage": stage.name,
        "settings": {key: job.settings(key) for key in stage.settings},
        "needs": {name: needed[name].hash for name in stage.needs if name in needed},
        "inputs": stage.inputs(job),
        "version": version("scene2skill"),
    }
    return hashlib.sha256(json.dumps(went_in, sort_keys=True).encode()).hexdigest()


def setting(job: Job, key: str):
    """What a config group stands for: an object, or a function that waits for its arguments."""
    return instantiate(OmegaConf.select(job.cfg, key), _convert_="all")


def progress(items, title: str):
    """The items, with a bar while somebody watches."""
    from tqdm import tqdm

    return tqdm(items, desc=f"  {title}", leave=False, disable=not watched())


def watched() -> bool:
    """Progress bars are for people, not for log files."""
    return sys.stderr.isatty()


def write_json(path: Path, value) -> None:
    """Write whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, default=float) + "\n", encoding="utf-8")


def _size_mb(path: Path) -> float:
    return sum(one.stat().st_size for one in ([path] if path.is_file() else path.rglob("*"))) / 2**20


def _move(source: Path, target: Path) -> None:
    if target.is_dir():
        shutil.rmtree(target)
    os.replace(source, target)


def _copy(source: Path, target: Path) -> None:
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    copy = shutil.copytree if source.is_dir() else shutil.copyfile
    copy(source, temporary)
    _move(temporary, target)
