"""What two views know of each other: the epipolar geometry, and which moments of two strokes it lets correspond.

Notation
    F               fundamental matrix: (b, 1)^T F (a, 1) = 0 for pixels a, b of the same point
    e(a, b)         signed Sampson distance [px] (Hartley and Zisserman 2004, eq. 11.9)
    l(u)            lag: one curve at u - l / 2 and another at u + l / 2 show the same moment; u in [0, 1]
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from scene.camera import Camera

SLOPE, STATES = 1.5, 121
"""Steepest lag, so that no curve runs backwards; number of lags looked at, evenly within MOST."""
MOST = 0.45
OUTLIER = 5.0
"""A distance beyond this many standard deviations costs no more."""


def fundamental(camera_a: Camera, camera_b: Camera) -> np.ndarray:
    """F (3, 3) of two cameras, scaled to norm 1."""
    epipole = camera_b.projection @ np.append(camera_a.centre, 1.0)
    cross = np.array([[0, -epipole[2], epipole[1]], [epipole[2], 0, -epipole[0]], [-epipole[1], epipole[0], 0]])
    F = cross @ camera_b.projection @ np.linalg.pinv(camera_a.projection)
    return F / np.linalg.norm(F)


def sampson(a, b, F) -> np.ndarray:
    """Signed Sampson distance (N,) [px] of pixels a and b (N, 2): to first order how far all four numbers must move,
    RSS."""
    a, b = (np.column_stack([x, np.ones(len(x))]) for x in (a, b))
    lines_b, lines_a = a @ F.T, b @ F  # epipolar lines of a in the picture of b, and of b in the picture of a
    gradient = np.sqrt((lines_b[:, :2] ** 2).sum(-1) + (lines_a[:, :2] ** 2).sum(-1))
    return (lines_b * b).sum(-1) / np.maximum(gradient, 1e-300)


def at(curve, fractions) -> np.ndarray:
    """Points of curve (N, D), given at even fractions, at others (K,); beyond the ends it goes on straight."""
    x = np.asarray(fractions) * (len(curve) - 1)
    i = np.clip(x.astype(int), 0, len(curve) - 2)
    return curve[i] + (x - i)[:, None] * (curve[i + 1] - curve[i])


def lag_between(a, b, F, sigma: float, size: float) -> tuple[np.ndarray, float]:
    """The best lag (N,) between two views' curves (N, 2) [px], and its cost.

    min_l  mean_u  (e / sigma)^2 + 2 (l / size)^2 + (l' / 5 size)^2 / 2   over all lags; sigma: of e [px].
    """
    return _best_lag(lambda u, lag: sampson(at(a, u - lag / 2), at(b, u + lag / 2), F), len(a), sigma, size)


def lag_behind(curve, seen, sigma: float, size: float) -> tuple[np.ndarray, float]:
    """As ``lag_between``, for where a view's curve (N, 2) [px] shows a motion that it should see at ``seen`` (N, 2)
    [px]: curve(u + l) is seen(u)."""
    return _best_lag(lambda u, lag: np.linalg.norm(at(curve, u + lag) - seen, axis=1), len(curve), sigma, size)


def _best_lag(distance, count: int, sigma: float, size: float) -> tuple[np.ndarray, float]:
    """Viterbi's algorithm over a grid of lags, 0 at both ends."""
    u, lags = np.linspace(0, 1, count), np.linspace(-MOST, MOST, STATES)
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
