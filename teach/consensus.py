"""Which views draw the same motion: consensus by the pair of views that most others agree with (after RANSAC).

A pair always meets somewhere along its epipolar lines; what it says is put to the test in the other views. A view
disagrees where its mean stroke misses the motion of the others by more than people's hands do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from teach.bundle import COUNT, LAGS, BENDS, Bundle, ViewedStroke, adjust, solve, starts
from teach.epipolar import at, lag_behind

DISAGREES = 4.0
"""RMS miss over the RMS fault of a hand from which a view contradicts the others."""
LAG = 0.12


@dataclass(frozen=True, eq=False)
class Consensus:
    """bundle: of the views that agree, in their order. agree: (V,). off: (V,) [px], RMS miss of each view's mean stroke
    from the motion of those that agree."""

    bundle: Bundle
    agree: Bool[np.ndarray, " V"]
    off: Float[np.ndarray, " V"]


def consensus(views: Sequence[ViewedStroke], robust: bool = True) -> Consensus:
    """The motion that the most views agree on. robust: False keeps all views, whatever they say."""
    if len(views) == 2:
        return _judged(views, adjust(views), np.array([True, True]))
    tests = [_tested(views, pair) for pair in _pairs(views)]
    lags, misses = min(tests, key=lambda test: np.minimum(test[1], DISAGREES).sum())
    agree = misses < DISAGREES if robust else np.ones(len(views), dtype=bool)
    agree[np.argsort(misses)[:2]] = True
    bundle = adjust([view for view, ok in zip(views, agree, strict=True) if ok], lags[agree])
    return _judged(views, bundle, agree)


def _pairs(views) -> list[tuple[int, int]]:
    """For each view the partner whose view crosses its own best."""
    forward = np.stack([view.camera.rays(view.mean.mean(axis=0))[1] for view in views])
    across = np.abs(np.linalg.norm(np.cross(forward[:, None], forward[None]), axis=-1))
    return sorted({tuple(sorted((i, int(across[i].argmax())))) for i in range(len(views))}) or [(0, 1)]


def _tested(views, pair) -> tuple[np.ndarray, np.ndarray]:
    """The lags (V, COUNT) of all views given the curve of a pair of them, and each one's miss over its fault (V,)."""
    two = [views[i] for i in pair]
    tried = [solve(two, lags, LAGS[1], BENDS[2]) for lags in starts(*two)]
    bundle = max(tried, key=lambda bundle: bundle.evidence)
    lags, misses = np.zeros((len(views), COUNT)), np.zeros(len(views))
    for i, view in enumerate(views):
        lag = bundle.lags[pair.index(i)] if i in pair else _lag(view, bundle.points)
        lags[i], misses[i] = lag, miss(view, bundle.points, lag) / view.sigma
    return lags, misses


def _lag(view: ViewedStroke, points) -> np.ndarray:
    seen = view.camera.project(points)
    return lag_behind(view.mean, np.nan_to_num(seen, nan=1e6), 2 * view.sigma, LAG)[0]


def miss(view: ViewedStroke, points, lag) -> float:
    """RMS distance [px] along one axis of the view's mean stroke from the projected points (COUNT, 3); infinite behind
    the camera."""
    off = at(view.mean, np.linspace(0, 1, COUNT) + lag) - view.camera.project(points)
    return float(np.sqrt((off**2).mean())) if np.isfinite(off).all() else np.inf


def _judged(views, bundle, agree) -> Consensus:
    given = iter(bundle.lags)
    lags = [next(given) if ok else _lag(view, bundle.points) for view, ok in zip(views, agree, strict=True)]
    return Consensus(bundle, agree, np.array([miss(v, bundle.points, l) for v, l in zip(views, lags, strict=True)]))
