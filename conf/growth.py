"""How figures grow: y = a x^b over a setting x of numbers, by least squares of log y on log x, with b's 95 % interval.

And what many need, by that fit and on paper: ``experiment.on_paper`` says how many of what (``times``, ``of``), at which x (``at``), and the columns
that add up: seconds, MB on disk; of memory [MB] the largest counts, since jobs do not know of each other.
"""

from collections.abc import Iterable

import numpy as np

from conf.results import Results, Row


def number(rows: list[Row]) -> str | None:
    """The one setting whose values are all numbers, at least three of them."""
    keys = [key for key in (rows[0].settings if rows else {}) if len({row.settings[key] for row in rows}) > 2]
    numbers = [key for key in keys if all(_is_number(row.settings[key]) for row in rows)]
    return numbers[0] if len(numbers) == 1 else None


def exponent(x, y) -> tuple[float, float]:
    """b of y = a x^b, and the half width of its 95 % interval (Student's t; nan of two points). x, y: (n,) positive."""
    from scipy.stats import t

    u, v = np.log(x) - np.log(x).mean(), np.log(y) - np.log(y).mean()
    b = float(u @ v / (u @ u))
    if len(u) < 3:
        return b, np.nan
    return b, float(t.ppf(0.975, len(u) - 2) * np.sqrt(((v - b * u) ** 2).sum() / (len(u) - 2) / (u @ u)))


def said(results: Results) -> Iterable[str]:
    """A sentence for each column that was measured, if the experiment asks for it."""
    key = number(results.rows) if results.growth else None
    if key is None:
        return
    for name, pairs in _measured(results, key).items():
        b, half = exponent(*pairs.T)
        (x, y), (far, most) = pairs[pairs[:, 0].argmin()], pairs[pairs[:, 0].argmax()]
        yield f"{name} grows as {key}^{b:.2f} (± {half:.2f}): {y:.3g} at {x:g}, {most:.3g} at {far:g}"
    if results.on_paper:
        yield from _on_paper(results.on_paper, _measured(results, key), key)


def _measured(results: Results, key: str) -> dict[str, np.ndarray]:
    """(n, 2): the setting and the figure, of each column that was measured at three values of it or more."""
    found = {}
    for column, name in enumerate(results.columns):
        pairs = np.array([(float(row.settings[key]), value) for row in results.rows for value in row.values[:, column]])
        pairs = pairs[((pairs > 0) & np.isfinite(pairs)).all(axis=1)]
        if len(set(pairs[:, 0])) > 2:
            found[name] = pairs
    return found


def _on_paper(spec: dict, measured: dict[str, np.ndarray], key: str) -> Iterable[str]:
    """What ``times`` of them need: a sentence, and what it rests on."""
    def fitted(name: str) -> float:
        x, y = measured[name].T
        return float(np.exp(np.log(y).mean() + exponent(x, y)[0] * (np.log(spec["at"]) - np.log(x).mean())))

    known = {part: [fitted(name) for name in spec[part] if name in measured] for part in ("seconds", "memory", "disk")}
    if not all(known.values()):
        return
    x = np.concatenate([pairs[:, 0] for pairs in measured.values()])
    seconds, disk, memory = spec["times"] * sum(known["seconds"]), spec["times"] * sum(known["disk"]), max(known["memory"])
    outside = "" if x.min() <= spec["at"] <= x.max() else f", and {spec['at']:g} is outside of them"
    yield (f"On paper, {spec['of']} need {_long(seconds)} of this machine, jobs one after the other, {disk / 1024:.3g} GB of disk and {memory / 1024:.2g} GB "
           f"of memory for each job that runs. Nobody ran so many: a fit over {key} from {x.min():g} to {x.max():g}{outside}, times {spec['times']:,}")  # fmt: skip


def _long(seconds: float) -> str:
    unit, name = next((u, n) for u, n in ((86400 * 365, "years"), (86400, "days"), (3600, "hours"), (60, "minutes"), (0, "seconds")) if seconds >= 2 * u)
    return f"{seconds / (unit or 1):.2g} {name}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
