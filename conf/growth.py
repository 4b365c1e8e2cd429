"""How figures grow: y = a x^b over a setting x of numbers, by least squares of log y on log x, with b's 95 % interval."""

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
    for column, name in enumerate(results.columns):
        pairs = np.array([(float(row.settings[key]), value) for row in results.rows for value in row.values[:, column]])
        pairs = pairs[((pairs > 0) & np.isfinite(pairs)).all(axis=1)]
        if len(set(pairs[:, 0])) > 2:
            b, half = exponent(*pairs.T)
            (x, y), (far, most) = pairs[pairs[:, 0].argmin()], pairs[pairs[:, 0].argmax()]
            yield f"{name} grows as {key}^{b:.2f} (± {half:.2f}): {y:.3g} at {x:g}, {most:.3g} at {far:g}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
