"""Strokes that repeat one motion on one view: which of their points show the same moment.

Notation
    s        arc length along a stroke over its whole, in [0, 1]
    d_i(s)   direction of stroke i, of length 1
    l_i(u)   lag: stroke i shows at s = u + l_i(u) the moment that the strokes together show at u; their mean is 0

A hand that makes one arm of a letter longer comes to the next corner later, and the mean at equal arc length has that
corner cut off. What corresponds is found by direction, since place and size differ from stroke to stroke and a corner
stays one: each stroke is warped towards the mean direction of all, and that is worked out anew (elastic means of
curves, Srivastava et al. 2011).
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from teach.curve import directions
from teach.lag import at, best_lag

ROUNDS, SMOOTHING = 3, 1.0
"""Times that the mean is worked out; smoothing before directions are taken [points]."""
TURN, LAG, MOST = 0.25, 0.12, 0.15
"""Deviation of a direction [rad]; size of the lags and the largest, of the arc length."""


def lags_of_repeats(strokes: Sequence[np.ndarray]) -> np.ndarray:
    """l_i (S, N) of strokes (N, 2) [px] at even arc length; 0 for a single one."""
    lags = np.zeros((len(strokes), len(strokes[0])))
    if len(strokes) == 1:
        return lags
    u, directions = np.linspace(0, 1, len(strokes[0])), [_direction(stroke) for stroke in strokes]
    for _ in range(ROUNDS):
        mean = np.mean([at(d, u + lag) for d, lag in zip(directions, lags, strict=True)], axis=0)
        lags = np.stack([_lag(d, mean) for d in directions])
        lags -= lags.mean(axis=0)
    return lags


def _direction(stroke) -> np.ndarray:
    return directions(gaussian_filter1d(stroke, SMOOTHING, axis=0, mode="nearest"))


def _lag(direction, mean) -> np.ndarray:
    unlike = lambda u, lag: np.linalg.norm(at(direction, np.clip(u + lag, 0, 1)) - mean, axis=1)
    return best_lag(unlike, len(mean), TURN, LAG, MOST)[0]
