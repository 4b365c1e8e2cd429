"""The short form of a table, as the README has it, and the figures it is made of, kept in docs/results/NAME.json.

    python -m conf.table runs/table1/A runs/table1_paper/B --keep table1

In the short form the values of ``experiment.across`` stand side by side, and the columns of a cell are parted by a slash. What
jobs measure beside their own method is of their sketches, so it stands there once. A README has it between <!-- NAME --> and
<!-- end -->.
"""

import re
from pathlib import Path

import numpy as np

from conf.results import JobResult, Results, Row, interval, read_by, variant
from conf.stages import write_json
from scene.files import read_json, replacing


def markdown(results: Results) -> str:
    """The table as text."""
    head, body = cells(results)
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *body))


def cells(results: Results) -> tuple[list[str], list[list[str]]]:
    """Head and lines of the table: one line for each method, and one for what others published."""
    places = {key: list(dict.fromkeys(row.settings.get(key) for row in results.rows)) for key in results.across}
    ordered = sorted(results.rows, key=lambda row: [places[key].index(row.settings.get(key)) for key in results.across])
    sides = {_side(results, row): _across(results, row) for row in ordered}
    lines: dict[str, dict[str, str]] = {}
    for row in results.rows:
        cell = lines.setdefault(_title(results, row), {})
        cell.setdefault(_side(results, row), _figures(row))
    lines |= {title: {side: _published(found, values) for side, values in sides.items()} for title, found in results.published.items()}
    return [" / ".join(results.columns), *sides], [[title, *(found.get(side, "") for side in sides)] for title, found in lines.items()]


def _published(found: dict[str, str], values: set[str]) -> str:
    """What was published of a side with these values of ``across``; where they leave something open, the first that fits."""
    return next((text for key, text in found.items() if values <= set(key.split(", "))), "")


def _across(results: Results, row: Row) -> set[str]:
    """The row's values of ``across``, those too in which no job differs."""
    settings = results.jobs[0].settings | row.settings
    return {settings[key] for key in results.across if key in settings}


def _side(results: Results, row: Row) -> str:
    return ", ".join(row.settings[key] for key in results.across if key in row.settings) or "all"


def _title(results: Results, row: Row) -> str:
    method = row.settings.get("method")
    if results.methods.get(method, ""):  # measured beside the job's own
        return method
    return ", ".join(value for key, value in row.settings.items() if key not in results.across) or "all"


def _figures(row: Row) -> str:
    def cell(values):
        mean, std, n, *_ = interval(values)
        return (f"{mean:.1f} ± {std:.1f}" if n > 1 else f"{mean:.1f}") if n else "-"

    return " / ".join(map(cell, row.values.T))


def keep(results: Results, path: Path) -> None:
    """Write the settings and figures that the table is made of."""
    needed = {variant(column, prefix) for column, _ in results.columns.values() for prefix in (results.methods or {"": ""}).values()}
    jobs = [
        {
            "settings": {key: job.settings[key] for key in dict.fromkeys((*results.varied, *results.across)) if key in job.settings},
            "figures": {name: float(f"{job.figures[name]:.5g}") for name in sorted(needed) if np.isfinite(job.figures.get(name, np.nan))},
            "code": job.code,
            "sketches": job.sketches and job.sketches[:16],
        }
        for job in results.jobs
        if job.state == "finished"
    ]
    spec = {"over": results.over, "columns": results.columns, "rows": results.methods, "across": results.across, "published": results.published,
            "growth": results.growth}  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"experiment": spec, "jobs": jobs})


def kept(path: Path) -> Results:
    """The results that ``keep`` wrote."""
    stored = read_json(path, f"no results are kept in {path}")
    jobs = tuple(JobResult(Path(str(i)), "finished", "", job["settings"], job["figures"], job["code"], job["sketches"]) for i, job in enumerate(stored["jobs"]))
    return read_by(stored["experiment"], jobs, {name for job in jobs for name in job.figures})


def in_readme(text: str, name: str, table: str | None = None) -> str | None:
    """The README's table of that name; with ``table``, the README's text with it in its place. None where it has no such place."""
    place = re.search(rf"(?<=<!-- {re.escape(name)} -->\n).*?(?=<!-- end -->)", text, re.DOTALL)
    if place is None:
        return None
    return place[0].rstrip("\n") if table is None else f"{text[: place.start()]}{table}\n{text[place.end() :]}"


def write_readme(readme: Path, name: str, table: str) -> bool:
    """Put the table in its place; whether there is one."""
    changed = in_readme(readme.read_text(encoding="utf-8"), name, table)
    if changed is not None:
        with replacing(readme) as temporary:
            temporary.write_text(changed, encoding="utf-8")
    return changed is not None
