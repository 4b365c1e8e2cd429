"""What is shown of a sweep: table.md, results.csv, plots, and report.html with what each job made side by side."""

import base64
import csv
import html
import os
from pathlib import Path

import numpy as np

from conf import growth, short
from conf.report import STYLE
from conf.results import JobResult, Results, cells, comparisons, interval, markdown, yes_or_no
from scene.files import replacing

SORTS = """
document.querySelectorAll('th button').forEach((button) => button.addEventListener('click', () => {
  const th = button.parentElement, body = th.closest('table').tBodies[0], i = th.cellIndex;
  const up = th.getAttribute('aria-sort') !== 'ascending';
  th.parentElement.querySelectorAll('th').forEach((other) => other.removeAttribute('aria-sort'));
  th.setAttribute('aria-sort', up ? 'ascending' : 'descending');
  const value = (row) => { const text = row.cells[i].textContent, n = parseFloat(text); return isNaN(n) ? text : n };
  [...body.rows].sort((a, b) => (value(a) < value(b) ? -1 : value(a) > value(b) ? 1 : 0) * (up ? 1 : -1)).forEach((row) => body.append(row));
}));
"""
LOOK = """
body { max-width: 96rem } th button { all: unset; cursor: pointer; font-weight: 600 } th button:focus-visible { outline: 2px solid }
th[aria-sort=ascending] button::after { content: ' \\25B2' } th[aria-sort=descending] button::after { content: ' \\25BC' }
ul.jobs { list-style: none; padding: 0; display: grid; grid-template-columns: repeat(auto-fill, minmax(20rem, 1fr)); gap: 1.5rem }
ul.jobs li { border-top: 1px solid var(--line); padding-top: .4rem } .failed { color: var(--bad) }
div.wide { overflow-x: auto; margin: 1rem 0 } div.wide td { white-space: nowrap }
div.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(30rem, 100%), 1fr)); gap: 0 1.5rem }
"""


def write(results: Results, folder: Path) -> Path:
    """Write results.csv, table.md, plots/*.png and report.html into ``folder``; returns the page's path."""
    rows = [_line(results, job) for job in results.jobs]
    with replacing(folder / "results.csv") as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)
    with replacing(folder / "table.md") as temporary:
        temporary.write_text(table_of(results), encoding="utf-8")
    with replacing(folder / "report.html") as temporary:
        temporary.write_text(_page(results, folder), encoding="utf-8")
    return folder / "report.html"


def table_of(results: Results) -> str:
    """The table, in its short form first where it has one, its notes, and how its figures grow."""
    side_by_side = f"{short.markdown(results)}\n\n" if results.across and results.rows else ""
    return side_by_side + markdown(results) + "".join(f"- {sentence}\n" for sentence in growth.said(results))


def _page(results: Results, folder: Path) -> str:
    title = html.escape(results.jobs[0].settings.get("experiment", folder.parent.name))
    parts = [
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{title}</title><style>{STYLE}{LOOK}</style></head><body><h1>{title}</h1>",
        "<ul>" + "".join(f"<li>{html.escape(note)}" for note in results.notes) + "</ul>",
    ]
    if results.rows:
        parts += [_table(*short.cells(results))] if results.across else []
        parts += [_table(*cells(results)), _list("Growth", growth.said(results)), _list("Compared in pairs", comparisons(results))]
        parts += ["<div class=plots>", *map(_plot, plots(results, folder / "plots")), "</div>"]
    parts += ["<h2>Jobs</h2><ul class=jobs>", *[_job(results, job, folder) for job in results.jobs], f"</ul><script>{SORTS}</script></body></html>"]
    return "\n".join(parts)


def _plot(path: Path) -> str:
    return f'<figure><img alt="{html.escape(path.stem)}" src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"></figure>'


def plots(results: Results, folder: Path) -> list[Path]:
    """One picture for each column: a curve with its 95 % band over a setting of numbers, else every job and the mean."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(exist_ok=True)
    paths = []
    for column, name in enumerate(results.columns):
        figure, axes = plt.subplots(figsize=(8, max(2.4, 1 + 0.34 * len(results.rows))), layout="constrained")
        number = growth.number(results.rows)
        _curves(axes, results, column, number) if number else _dots(axes, results, column)
        axes.set(**{("ylabel" if number else "xlabel"): name})
        axes.set_title(f"mean and its 95 % interval{'' if number else '; grey: each job'}", fontsize=8, loc="left")
        if number and results.growth:
            axes.set(xscale="log", yscale="log")
        axes.grid(alpha=0.3, which="both" if results.growth else "major")
        paths.append(folder / f"{results.columns[name][0]}.png")
        figure.savefig(paths[-1], dpi=110)
        plt.close(figure)
    return paths


def _curves(axes, results: Results, column: int, key: str) -> None:
    groups: dict[tuple, list] = {}
    means = []
    for row in results.rows:
        groups.setdefault(tuple(v for k, v in row.settings.items() if k != key), []).append(row)
    for label, rows in groups.items():
        rows = sorted(rows, key=lambda row: float(row.settings[key]))
        x = [float(row.settings[key]) for row in rows]
        mean, _, _, low, high = np.array([interval(row.values[:, column]) for row in rows]).T
        axes.plot(x, mean, marker="o", label=", ".join(label))
        axes.fill_between(x, low, high, alpha=0.2)
        means += [*mean]
    axes.set_xlabel(key)
    _not_for_the_band(axes, np.array(means), results.growth)
    if len(groups) > 1:
        axes.legend()


def _not_for_the_band(axes, means: np.ndarray, logarithmic: bool) -> None:
    """The interval of two or three repetitions may be many times the means: these have the picture's height, and half as much on either side."""
    low, high = np.nanmin(means), np.nanmax(means)
    if logarithmic or not high > low:
        return
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low - (high - low) / 2), min(top, high + (high - low) / 2))


def _dots(axes, results: Results, column: int) -> None:
    for i, row in enumerate(results.rows):
        values = row.values[:, column]
        mean, _, n, low, high = interval(values)
        axes.plot(values, np.full(len(values), i), ".", color="0.6")
        axes.errorbar(mean, i, xerr=[[mean - low], [high - mean]] if n > 1 else None, fmt="o", color="C0", capsize=3)
    axes.set_yticks(range(len(results.rows)), [", ".join(row.settings.values()) for row in results.rows])
    axes.invert_yaxis()
    if all(yes_or_no(row.values[:, column]) for row in results.rows):
        axes.set_xlim(-0.03, 1.03)


def _list(title: str, sentences) -> str:
    lines = "".join(f"<li>{html.escape(sentence)}" for sentence in sentences)
    return f"<h2>{title}</h2><ul>{lines}</ul>" if lines else ""


def _table(head: list[str], body: list[list[str]]) -> str:
    titles = "".join(f"<th><button>{html.escape(title)}</button>" for title in head)
    lines = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}" for cell in line) for line in body)
    return f"<div class=wide><table><thead><tr>{titles}</thead><tbody>{lines}</tbody></table></div>"


def _job(results: Results, job: JobResult, folder: Path) -> str:
    said = html.escape(", ".join(f"{key}={job.settings[key]}" for key in results.varied if key in job.settings) or job.folder.name)
    where = html.escape(os.path.relpath(job.folder, folder))
    there = [name for name in results.pictures if (job.folder / "figures" / f"{name}.png").exists()]
    shown = "".join(f'<img loading=lazy alt="{html.escape(name)}, {said}" src="{where}/figures/{html.escape(name)}.png">' for name in there)
    page = "report.html" if (job.folder / "report.html").exists() else ""
    link = f'<a href="{where}/{page}">{shown}<p>{said}</p></a>'
    failed = "" if job.state == "finished" else f"<p class=failed>{html.escape(job.state)}: {html.escape(job.error)}"
    return f"<li>{link}{failed}"


def _line(results: Results, job: JobResult) -> dict:
    settings = {key: job.settings.get(key, "") for key in results.varied}
    return {"job": f"{job.folder.parent.name}/{job.folder.name}", "state": job.state, "error": "" if job.state == "finished" else job.error} | settings | job.figures
