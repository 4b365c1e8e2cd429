"""How far strokes spread in each view, of what all views tell: few strokes of a view say little of it alone.

Notation
    s_v^2    variance of view v's strokes about their mean, over their drawing's squared extent
    n_v      its degrees of freedom: of each stroke but one as many as a hand's faults are independent (Satterthwaite 1946)

One hand draws all views, so that s_v^2 differ by chance as chi squared over n_v does: Var log s_v^2 = psi'(n_v / 2). Log
variances are drawn towards their mean by the share of their scatter that chance explains, all of it where one time in a hundred it
scatters as much (positive-part shrinkage, James and Stein 1961): a view that was drawn far more carefully keeps its own.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import polygamma
from scipy.stats import chi2

from teach.bundle import hand_faults
from teach.curve import deviation, extent

SURE = 0.99
"""How unlikely a scatter by chance has to be before views count as drawn with different care."""
LEAST = 1e-6
"""Variance [of the squared extent] below which strokes are copies of one another and tell nothing of a hand."""


def pooled(views: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The strokes (S, N, 2) [px] of each view about the same mean, as far from it as all views say. Views of one stroke, or
    of copies, stay as they are."""
    variances = np.array([_variance(strokes) for strokes in views])
    hands = np.flatnonzero(variances > LEAST)
    if len(hands) < 2:
        return list(views)
    free = np.array([_freedom(views[k]) for k in hands])
    chance, logs = polygamma(1, free / 2), np.log(variances[hands])
    middle = np.average(logs, weights=1 / chance)
    scatter = ((logs - middle) ** 2 / chance).sum()
    own = max(0.0, 1 - chi2.ppf(SURE, len(hands) - 1) / scatter) if scatter > 0 else 0.0
    sizes = np.ones(len(views))
    sizes[hands] = np.exp((1 - own) * (middle - logs) / 2)
    return [strokes.mean(axis=0) + size * (strokes - strokes.mean(axis=0)) for strokes, size in zip(views, sizes, strict=True)]


def _variance(strokes) -> float:
    return (deviation(strokes) / max(extent(strokes.mean(axis=0)), 1.0)) ** 2 if len(strokes) > 1 else 0.0


def _freedom(strokes) -> float:
    """Satterthwaite's, of covariances C along each axis: (tr C)^2 / tr C^2."""
    C = hand_faults(strokes.mean(axis=0))
    independent = np.trace(C, axis1=1, axis2=2).sum() ** 2 / (C**2).sum()
    return (len(strokes) - 1) * float(independent)
