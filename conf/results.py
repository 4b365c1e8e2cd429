"""What the jobs of a sweep found, as rows of a table.

A row of the table is a configuration: the settings that differ between jobs, without those of ``experiment.over``,
which repeat it (seeds). Its figures are mean, standard deviation over repetitions, their number and a 95 % confidence
interval of the mean (Student's t; Wilson's of successes). Rows that saw the same sketches (equal files) are compared in pairs by Wilcoxon's
signed-rank test. How an experiment is read stands in its YAML:

    over      settings that repeat a configuration
    columns   name in the table: [path in metrics.json, factor]; null leaves one of config.yaml's out
    rows      name of a method: prefix of the metric, for methods that a job measures beside its own (oracle_, linear_)
    across    settings whose values stand side by side in the short form of the table (short.py)
    published name of a row: {value of ``across``: text}, what others reported
    pictures  of a job's figures/, shown in the sweep's page
    growth    true: figures over a setting of numbers are fitted by a power of it (growth.py)
    on_paper  {of, times, at, seconds, memory, disk}: what many of these need by that fit (growth.py)
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from scene.files import read_json


@dataclass(frozen=True)
class JobResult:
    """One job of a sweep. settings: what its command line says; figures: metrics.json, flat; sketches: hash of what was drawn."""

    folder: Path
    state: str
    error: str
    settings: dict[str, str]
    figures: dict[str, float]
    code: str | None
    sketches: str | None


@dataclass(frozen=True)
class Row:
    """One configuration. values: (jobs, columns), nan where a job has no such figure; sketches: (jobs,)."""

    settings: dict[str, str]
    values: np.ndarray
    sketches: tuple[str | None, ...]


@dataclass(frozen=True)
class Results:
    """All jobs of one or more sweeps, and how they are read."""

    jobs: tuple[JobResult, ...]
    over: tuple[str, ...]
    columns: dict[str, tuple[str, float]]
    methods: dict[str, str]
    across: tuple[str, ...] = ()
    published: dict[str, dict[str, str]] = field(default_factory=dict)
    growth: bool = False
    on_paper: dict | None = None
    pictures: tuple[str, ...] = ("overview",)
    stopped: tuple[Path, ...] = ()

    @property
    def missing(self) -> list[JobResult]:
        return [job for job in self.jobs if job.state != "finished"]

    @cached_property
    def varied(self) -> list[str]:
        """Settings that differ between jobs; the experiment's name only where the others leave it open."""
        keys = dict.fromkeys(key for job in self.jobs for key in job.settings)
        values = lambda *names: {tuple(job.settings.get(name) for name in names) for job in self.jobs}
        differ = [key for key in keys if len(values(key)) > 1]
        others = [key for key in differ if key != "experiment" and key not in self.over]
        return [key for key in differ if key != "experiment" or len(values(*others)) < len(values(*others, key))]

    @cached_property
    def rows(self) -> list[Row]:
        configured = [key for key in self.varied if key not in self.over]
        groups: dict[tuple, list] = {}
        for job in self.jobs:
            for method, prefix in (self.methods or {"": ""}).items():
                settings = tuple((key, job.settings.get(key, "")) for key in configured) + ((("method", method),) if method else ())
                figures = [factor * job.figures.get(variant(path, prefix), np.nan) for path, factor in self.columns.values()]
                figures = [value if np.isfinite(value) else np.nan for value in figures]
                if job.state == "finished" and any(variant(path, prefix) in job.figures for path, _ in self.columns.values()):
                    groups.setdefault(settings, []).append((figures, job.sketches))
        return [Row(dict(settings), np.array([f for f, _ in found]), tuple(s for _, s in found)) for settings, found in groups.items()]

    @cached_property
    def notes(self) -> list[str]:
        """What a reader must know of the figures."""
        finished = len(self.jobs) - len(self.missing)
        notes = [f"{finished} of {len(self.jobs)} jobs finished."]
        notes += [f"{folder.name} was stopped, or still runs: jobs that did not begin are not counted; the same command goes on with it." for folder in self.stopped]
        which = lambda job: said({key: job.settings[key] for key in self.varied if key in job.settings})
        notes += [f"Missing: {job.folder.name} ({which(job)}): {job.state}, {job.error}" for job in self.missing]
        codes = {job.code for job in self.jobs}
        notes += [f"These jobs ran {len(codes)} versions of the code: {', '.join(sorted(str(c)[:10] for c in codes))}."] if len(codes) > 1 else []
        holes = {name: sum(int(np.isnan(row.values[:, i]).sum()) for row in self.rows) for i, name in enumerate(self.columns)}
        return notes + [f"{name}: {count} jobs have no figure, or not a finite one, and are left out." for name, count in holes.items() if count]


def collect(folders: Sequence[Path]) -> Results:
    """Read the jobs of sweeps, or single jobs. Raises FileNotFoundError or ValueError where there is none to read."""
    jobs = tuple(_job(folder) for folder in _job_folders(folders))
    specs = [spec for spec in (_spec(job.folder) for job in jobs) if spec]
    if not specs:
        raise ValueError(f"no job of a sweep lies in {', '.join(map(str, folders))}: give runs/<experiment>/<time>")
    measured = {path for job in jobs for path in job.figures}
    stopped = tuple(folder for folder in folders if sweep_of(folder).get("state") in ("running", "stopped"))
    return replace(read_by(specs[0], jobs, measured), stopped=stopped)


def sweep_of(folder: Path) -> dict:
    """What sweep.json says of a folder; nothing where there is none. Raises ValueError where no sweep wrote it."""
    path = folder / "sweep.json"
    begun = read_json(path, "") if path.exists() else {}
    if not isinstance(begun, dict) or not isinstance(begun.get("key", {}), dict):
        raise ValueError(f"{path} is not what a sweep writes: move it away")
    return begun


def read_by(spec: dict, jobs: tuple[JobResult, ...], measured: set[str]) -> Results:
    """The jobs as an experiment's ``spec`` says, with the columns of which something is measured."""
    asked = {name: column for name, column in spec["columns"].items() if column}
    columns = {name: (path, float(factor)) for name, (path, factor) in asked.items() if path in measured}
    more = {"across": tuple(spec.get("across", ())), "published": spec.get("published", {}), "growth": spec.get("growth", False), "on_paper": spec.get("on_paper"),
            "pictures": tuple(spec.get("pictures", ["overview"]))}  # fmt: skip
    return Results(jobs, tuple(spec["over"]), columns, spec["rows"], **more)


def _job_folders(folders: Sequence[Path]) -> list[Path]:
    absent = [folder for folder in folders if not folder.is_dir()]
    if absent:
        raise FileNotFoundError(f"there is no folder {absent[0]}")
    found = {path.parent for folder in folders for pattern in ("status.json", "*/status.json") for path in folder.glob(pattern)}
    return sorted(found, key=lambda path: (str(path.parent), int(path.name) if path.name.isdigit() else 0, path.name))


def figures_of(run: Path) -> dict[str, float]:
    """metrics.json of a job, flat: teach.mfd, plan.feasible, ...; true is 1."""
    path = run / "metrics.json"
    metrics = read_json(path, "") if path.exists() else {}

    def flat(node: dict, above: str):
        for key, value in node.items():
            if isinstance(value, dict):
                yield from flat(value, f"{above}{key}.")
            elif isinstance(value, (int, float)):
                yield f"{above}{key}", float(value)

    if not isinstance(metrics, dict):
        raise ValueError(f"{path} holds no figures: it is not what a job writes")
    return dict(flat(metrics, ""))


def code_of(run: Path) -> str | None:
    """The commit of the code that a job ran; None where it is not known."""
    path = run / "provenance.json"
    return read_json(path, "").get("git") if path.exists() else None


def interval(values: np.ndarray) -> tuple[float, float, int, float, float]:
    """Mean, standard deviation (n - 1), n and the 95 % confidence interval of the mean; nan leaves out.

    Of yes and no (1 and 0) the interval is Wilson's: ten successes of ten do not make failure impossible.
    """
    from scipy.stats import binomtest, t

    kept = values[~np.isnan(values)]
    n = len(kept)
    if n < 2:
        mean = float(kept.mean()) if n else np.nan
        return mean, np.nan, n, np.nan, np.nan
    mean, std = kept.mean(), kept.std(ddof=1)
    if yes_or_no(kept):
        return float(mean), float(std), n, *binomtest(int(kept.sum()), n).proportion_ci(method="wilson")
    half = t.ppf(0.975, n - 1) * std / np.sqrt(n)
    return float(mean), float(std), n, float(mean - half), float(mean + half)


def paired(row: Row, reference: Row, column: int) -> tuple[int, float, float] | None:
    """Number of common sketches, mean difference and p by Wilcoxon; None with fewer than 5 pairs."""
    from scipy.stats import wilcoxon

    a, b = ({s: v for s, v in zip(r.sketches, r.values[:, column], strict=True) if s and not np.isnan(v)} for r in (row, reference))
    common = sorted(set(a) & set(b))
    if len(common) < 5:
        return None
    differences = np.array([a[s] - b[s] for s in common])
    p = 1.0 if not differences.any() else float(wilcoxon(differences).pvalue)
    return len(common), float(differences.mean()), p


def markdown(results: Results) -> str:
    """The table and its notes."""
    notes = [f"- {note}" for note in results.notes]
    if not results.rows:
        return "\n".join([*notes, "- No job has figures of the table's columns, experiment.columns."]) + "\n"
    head, body = cells(results)
    lines = ["| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *body)]
    return "\n".join([*lines, "", *notes, *[f"- {said}" for said in comparisons(results)]]) + "\n"


def cells(results: Results) -> tuple[list[str], list[list[str]]]:
    """Head and lines of the table, as text."""
    keys = list(results.rows[0].settings)
    head = [*keys, "n", *[part for name in results.columns for part in (name, "95 % CI")]]
    return head, [_cells(row, len(results.columns)) for row in results.rows]


def comparisons(results: Results) -> list[str]:
    """Each row against the first row that saw the same sketches."""
    found = []
    for i, row in enumerate(results.rows):
        for column, name in enumerate(results.columns):
            tests = ((other, paired(row, other, column)) for other in results.rows[:i])
            reference, test = next(((other, test) for other, test in tests if test), (None, None))
            if test is not None:
                n, difference, p = test
                found.append(f"{name}, {said(row.settings)} minus {said(reference.settings)}: {difference:+.3g} over {n} pairs (Wilcoxon p = {p:.2g})")
    return found


def _cells(row: Row, columns: int) -> list[str]:
    cells = [*row.settings.values(), str(len(row.values))]
    for column in range(columns):
        mean, std, n, low, high = interval(row.values[:, column])
        fewer = f" (n={n})" if n < len(row.values) else ""
        figure = f"{mean:.3g} ± {std:.2g}" if n > 1 else f"{mean:.3g}" if n else "-"
        rate = n and yes_or_no(row.values[:, column])
        cells += [f"{round(mean * n)} of {n}" if rate else figure + fewer, f"{low:.3g} to {high:.3g}" if n > 1 else ""]
    return cells


def yes_or_no(values: np.ndarray) -> bool:
    """Whether figures are of successes, 1 and 0; nan leaves out."""
    return bool(np.isin(values[~np.isnan(values)], (0, 1)).all())


def _job(folder: Path) -> JobResult:
    import yaml

    status = read_json(folder / "status.json", f"no job lies in {folder}")
    if not isinstance(status, dict) or "state" not in status:
        raise ValueError(f"{folder / 'status.json'} is no job's: give runs/<experiment>/<time>")
    overrides = folder / ".hydra" / "overrides.yaml"
    lines = yaml.safe_load(overrides.read_text()) if overrides.exists() else None
    pairs = [str(line).partition("=") for line in (lines if isinstance(lines, list) else [])]
    sketches = folder / "sketches.json"
    running = status["state"] == "running"
    return JobResult(
        folder, "did not come to its end" if running else status["state"],
        status.get("error", "killed, perhaps for want of memory, or still running" if running else "stopped"),
        {key.lstrip("+~"): value for key, _, value in pairs}, figures_of(folder), code_of(folder),
        hashlib.sha256(sketches.read_bytes()).hexdigest() if sketches.exists() else None,
    )  # fmt: skip


def _spec(folder: Path) -> dict | None:
    import yaml

    path = folder / ".hydra" / "config.yaml"
    return (yaml.safe_load(path.read_text()) or {}).get("experiment") if path.exists() else None


def variant(path: str, prefix: str) -> str:
    group, _, name = path.rpartition(".")
    return f"{group}.{prefix}{name}"


def said(settings: dict[str, str]) -> str:
    return ", ".join(f"{key}={value}" for key, value in settings.items()) or "as it stands"
