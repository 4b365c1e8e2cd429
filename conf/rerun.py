"""scene2skill rerun=runs/<experiment>/<time>/<number>: a stored job is done once more, and it is said whether the result agrees."""

import time
from pathlib import Path

import numpy as np
import yaml

from conf.results import code_of, figures_of
from conf.stages import status_of

TIMES = ("seconds", "render_seconds", "total_seconds", "peak_mb", "disk_mb")
"""Figures that no two runs share: of time, memory and disk."""


def expanded(arguments: list[str]) -> list[str]:
    """The command line of the job that ``rerun=FOLDER`` names, into a folder of its own; others as they are.

    Raises FileNotFoundError where no job lies there, ValueError where more is asked for.
    """
    named = [argument for argument in arguments if argument.startswith("rerun=")]
    if not named:
        return arguments
    if len(arguments) > 1:
        raise ValueError(f"rerun= repeats a job with its own settings: leave out {' '.join(a for a in arguments if a not in named)}")
    folder = Path(named[0].partition("=")[2]).resolve()
    stored = folder / ".hydra" / "overrides.yaml"
    if not stored.exists() or not (folder / "status.json").exists():
        raise FileNotFoundError(f"no job lies in {folder}: give runs/<experiment>/<time>/<number>")
    new = Path("runs", "rerun", time.strftime("%Y-%m-%d_%H-%M-%S"), "0").resolve()
    return [*(yaml.safe_load(stored.read_text()) or []), f"rerun='{folder}'", f"hydra.run.dir='{new}'"]


def verdict(run: Path, before: Path) -> list[str]:
    """What to say of a job done again in ``run``: whether its figures are those of ``before``, and if not, which differ."""
    figures, known = figures_of(run), figures_of(before)
    compared = [name for name in known if name.rpartition(".")[2] not in TIMES]
    differing = [name for name in compared if not np.array_equal(figures.get(name, np.nan), known[name], equal_nan=True)]
    if not compared:
        return [f"{before} has no figures to compare with: it was {status_of(before).get('state')}"]
    if not differing:
        return [f"agrees with {before}: all {len(compared)} figures are equal"]
    codes = [code_of(folder) for folder in (before, run)]
    said = [f"does not agree with {before}: {len(differing)} of {len(compared)} figures differ" + (", and so does the code" if codes[0] != codes[1] else "")]
    return said + [f"{name}: {known[name]:.6g} then, {figures.get(name, np.nan):.6g} now" for name in differing]
