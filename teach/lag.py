"""Which moments of two curves correspond, by dynamic programming.

Notation
    u       place along a curve, in [0, 1]; curves are given at even u
    l(u)    lag: where on one curve is what the other shows at u; 0 at both ends
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

SLOPE, STATES = 1.5, 121
"""Steepest lag, so that no curve runs backwards; number of lags looked at, evenly within MOST."""
MOST = 0.45
OUTLIER = 5.0
"""A distance beyond this many standard deviations costs no more."""


def at(curve, fractions) -> np.ndarray:
    """Points of curve (N, D), given at even fractions, at others (K,); beyond the ends it goes on straight."""
    x = np.asarray(fractions) * (len(curve) - 1)
    i = np.clip(x.astype(int), 0, len(curve) - 2)
    return curve[i] + (x - i)[:, None] * (curve[i + 1] - curve[i])


def lag_behind(curve, seen, sigma: float, size: float) -> tuple[np.ndarray, float]:
    """Where a view's curve (N, 2) [px] shows a motion that it should see at ``seen`` (N, 2)
    [px]: curve(u + l) is seen(u); and its cost."""
    return best_lag(lambda u, lag: np.linalg.norm(at(curve, u + lag) - seen, axis=1), len(curve), sigma, size)


def best_lag(distance, count: int, sigma: float, size: float, most: float = MOST) -> tuple[np.ndarray, float]:
    """The best lag (N,) at N = ``count`` even u and its cost, by Viterbi's algorithm over a grid of lags up to ``most``.

    min_l  mean_u  (d / sigma)^2 + 2 (l / size)^2 + (l' / 5 size)^2 / 2        distance: (u, l) -> d (N,)
    """
    u, lags = np.linspace(0, 1, count), np.linspace(-most, most, STATES)
    cost = np.stack([(np.minimum(distance(u, lag) / sigma, OUTLIER)) ** 2 + 2 * (lag / size) ** 2 for lag in lags], axis=1)
    cost[np.abs(lags) > 2 * np.minimum(u, 1 - u)[:, None] + 1e-9] = np.inf  # it would lie outside of a curve
    slope = (lags[:, None] - lags) * (count - 1)
    turn = np.where(np.abs(slope) <= SLOPE + 1e-9, (slope / (5 * size)) ** 2 / 2, np.inf)
    total, back = cost[0], []
    for row in cost[1:]:
        reached = total + turn
        back.append(reached.argmin(axis=1))
        total = row + reached.min(axis=1)
    best = state = int(total.argmin())
    states = [state]
    for step in reversed(back):
        states.append(state := int(step[state]))
    lag = gaussian_filter1d(lags[states[::-1]], 0.04 * count, mode="nearest")
    return lag - (1 - u) * lag[0] - u * lag[-1], float(total[best] / count)
