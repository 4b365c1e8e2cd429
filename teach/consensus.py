"""Which views draw the same motion: the views are kept that, taken as one curve, explain what was drawn best.

    log p(strokes | S) = log p(strokes of S | one curve) + sum over the others of log p(stroke | any curve)

S are the views kept. Two views nearly always meet somewhere along their epipolar lines, so with three of them that one
misses the curve of the other two says little of which it is: how well each pair meets does, and how its curve bends and
its lags have to run, which is what the evidence of teach.bundle weighs. Views are left out one by one while that gains
more than SURE. Curves are begun from those of pairs of views (after RANSAC, Fischler and Bolles 1981).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from teach.bundle import BENDS, COUNT, LAGS, Bundle, ViewedStroke, adjust, solve, starts
from teach.curve import extent
from teach.lag import at, lag_behind
from teach.likelihood import correlation
from teach.sketch import SketchError

SURE = 20.0
"""Log evidence that leaving a view out has to gain. Honest views lose 6 or more by it, contradicting ones gain 70 or more."""
TREMBLING = 0.01
"""Deviation of what is not smooth, of the drawing's extent: the evidence must not hang on a hand's least faults."""
ANYWHERE, ANYHOW, LENGTH = 0.3, 0.5, 0.25
"""Of a stroke that shows any curve: the deviation of its place [of the picture's width] and of its points [of its
extent], and their correlation length in arc length."""
DOT = 0.02
"""A drawing smaller than this share of the picture's width is a dot."""
ALL_PAIRS = 4
"""Up to so many views all pairs are tried; of more, each view and the one whose view crosses its own best."""
MOST, LAG = 8.0, 0.12
"""A miss beyond so many times a hand's fault counts no more, where pairs are compared; size of the lag there."""


@dataclass(frozen=True, eq=False)
class Consensus:
    """bundle: of the views that agree, in their order. agree: (V,). off: (V,) [px], RMS miss of each view's mean stroke
    from the motion of those that agree. rivals: views that may contradict instead of one that was left out. gain: log
    evidence that those that agree show one curve over that each shows any; negative: they had better be drawn again."""

    bundle: Bundle
    agree: Bool[np.ndarray, " V"]
    off: Float[np.ndarray, " V"]
    rivals: tuple[int, ...] = ()
    gain: float = np.inf


def consensus(views: Sequence[ViewedStroke], robust: bool = True) -> Consensus:
    """The motion that the views agree on. robust: False keeps all views, whatever they say. Raises SketchError if they put
    none in front of their cameras."""
    near_from_world = _near(views)
    near = [replace(view, camera=view.camera.moved(near_from_world)) for view in views]
    try:
        found = _consensus(near, robust)
    except (np.linalg.LinAlgError, ValueError):
        found = None
    if found is None or not np.isfinite(found.bundle.points).all():
        raise SketchError("the views put no one motion in front of their cameras: check that each sketch belongs to its "
                          "picture, and draw the one that does not once more")
    world_from_near = np.linalg.inv(near_from_world)
    points = found.bundle.points @ world_from_near[:3, :3].T + world_from_near[:3, 3]
    covariance = found.bundle.covariance * np.linalg.det(world_from_near[:3, :3]) ** (2 / 3)
    return replace(found, bundle=replace(found.bundle, points=points, covariance=covariance))


def _near(views) -> np.ndarray:
    """(4, 4) similarity that puts the cameras around the origin, about 1 from it, however far off and large the world
    is."""
    centres = np.stack([view.camera.centre for view in views])
    middle = centres.mean(axis=0)
    size = max(float(np.linalg.norm(centres - middle, axis=1).mean()), 1e-9)
    near_from_world = np.diag([1 / size, 1 / size, 1 / size, 1.0])
    near_from_world[:3, 3] = -middle / size
    return near_from_world


def _consensus(views, robust: bool) -> Consensus:
    agree, rivals, lags = np.ones(len(views), dtype=bool), (), None
    while robust and agree.sum() > 2:
        kept = np.flatnonzero(agree)
        out, others, lags = _contradicting([views[k] for k in kept])
        if out is None:
            break
        lags = None
        agree[kept[out]], rivals = False, (*rivals, *(int(kept[k]) for k in others))
    left = [view for view, ok in zip(views, agree, strict=True) if ok]
    if lags is None and len(left) > 2:
        lags = _best(_curves(left), len(left))
    bundle = adjust(left, lags if len(left) > 2 else None)
    plain = [_trembling(view) for view in left]
    one = _solved(plain, bundle.lags)
    gain = (one.evidence if one else -np.inf) - sum(anything(view) for view in plain)
    return replace(_judged(views, bundle, agree, tuple(k for k in rivals if agree[k])), gain=float(gain))


def _contradicting(views) -> tuple[int | None, list[int], np.ndarray]:
    """The view without which the others explain what was drawn best, None if none; others nearly as likely; and lags (V,
    COUNT) from which to adjust all views."""
    views = [_trembling(view) for view in views]
    any_curve = [anything(view) for view in views]
    pairs = _curves(views)
    everyone = tuple(range(len(views)))
    together = _evidence(views, everyone, pairs)
    gains = np.array([
        _evidence(views, tuple(i for i in everyone if i != k), pairs) + any_curve[k] for k in everyone
    ])  # fmt: skip
    dots = [extent(view.mean) < DOT * view.camera.width for view in views]
    gains[dots] = -np.inf  # a motion straight at the camera: its arc length is trembling, which contradicts nothing
    out = int(np.argmax(gains))
    if not np.isfinite(gains[out]) or gains[out] - together < SURE:
        return None, [], _best(pairs, len(views))
    return out, [k for k in everyone if k != out and gains[k] > gains[out] - SURE], _best(pairs, len(views))


def _trembling(view: ViewedStroke) -> ViewedStroke:
    return replace(view, trembling=view.trembling + (TREMBLING * max(extent(view.mean), 1.0)) ** 2)


def anything(view: ViewedStroke) -> float:
    """log p(stroke | any curve): a smooth one of its extent, anywhere on the picture."""
    u, size = np.linspace(0, 1, COUNT), (view.camera.width, view.camera.height)
    shape = (ANYHOW * extent(view.mean)) ** 2 * correlation(u, LENGTH)
    total = 0.0
    for axis, faults in enumerate(view.covariance):
        root = np.linalg.cholesky(faults + shape + (ANYWHERE * view.camera.width) ** 2)
        white = np.linalg.solve(root, view.mean[:, axis] - size[axis] / 2)
        total -= np.log(np.diag(root)).sum() + 0.5 * white @ white
    return float(total)


@dataclass(frozen=True, eq=False)
class _Begun:
    """The most probable curve of a pair of views, and where all views are on it: lags (V, COUNT), misses over faults (V,)."""

    bundle: Bundle
    lags: np.ndarray
    misses: np.ndarray


def _curves(views) -> dict[tuple[int, int], _Begun]:
    """For pairs of views the curve to begin from; of those that have one."""
    found = {}
    for pair in _pairs(views):
        two = [views[k] for k in pair]
        steps = 24 if len(views) <= ALL_PAIRS else 8  # of many views a pair's curve is but a start
        tried = [bundle for lags in starts(*two)[::2] if (bundle := _solved(two, lags, steps)) is not None]
        if tried:
            best = max(tried, key=lambda bundle: bundle.evidence)
            lags = [best.lags[pair.index(k)] if k in pair else _lag(view, best.points) for k, view in enumerate(views)]
            misses = [miss(view, best.points, lag) / view.sigma for view, lag in zip(views, lags, strict=True)]
            found[pair] = _Begun(best, np.stack(lags), np.minimum(misses, MOST))
    return found


def _pairs(views) -> list[tuple[int, int]]:
    everyone = range(len(views))
    if len(views) <= ALL_PAIRS:
        return list(combinations(everyone, 2))
    forward = np.stack([view.camera.rays(view.mean.mean(axis=0))[1] for view in views])
    across = np.linalg.norm(np.cross(forward[:, None], forward[None]), axis=-1)
    return sorted({tuple(sorted((k, int(across[k].argmax())))) for k in everyone} | {(k, k + 1) for k in everyone[:-1]})


def _evidence(views, kept, pairs) -> float:
    """log p(strokes of the views kept | one curve); -inf if there is none in front of all of them."""
    if len(kept) == 2 and kept in pairs:
        return pairs[kept].bundle.evidence
    inside = [pair for pair in pairs if set(pair) <= set(kept)]
    rows = list(kept)
    begun = sorted((pairs[pair] for pair in inside), key=lambda begun: begun.misses[rows].sum())[:2]
    tried = [_solved([views[k] for k in kept], one.lags[rows]) for one in begun]
    return max((bundle.evidence for bundle in tried if bundle is not None), default=-np.inf)


def _best(pairs, count: int) -> np.ndarray:
    """The lags (V, COUNT) of the pair's curve that all views miss least."""
    return min(pairs.values(), key=lambda begun: begun.misses.sum()).lags if pairs else np.zeros((count, COUNT))


def _solved(views, lags, steps: int = 24) -> Bundle | None:
    """The curve; None where it runs behind a camera."""
    try:
        bundle = solve(views, lags, LAGS[1], BENDS[2], steps=steps)
    except (np.linalg.LinAlgError, ValueError):
        return None
    return bundle if np.isfinite(bundle.evidence) and np.isfinite(bundle.points).all() else None


def _lag(view: ViewedStroke, points) -> np.ndarray:
    seen = view.camera.project(points)
    return lag_behind(view.mean, np.nan_to_num(seen, nan=1e6), 2 * view.sigma, LAG)[0]


def miss(view: ViewedStroke, points, lag) -> float:
    """RMS distance [px] along one axis of the view's mean stroke from the projected points (COUNT, 3); infinite behind
    the camera."""
    off = at(view.mean, np.linspace(0, 1, COUNT) + lag) - view.camera.project(points)
    return float(np.sqrt((off**2).mean())) if np.isfinite(off).all() else np.inf


def _judged(views, bundle, agree, rivals) -> Consensus:
    given = iter(bundle.lags)
    lags = [next(given) if ok else _lag(view, bundle.points) for view, ok in zip(views, agree, strict=True)]
    off = np.array([miss(view, bundle.points, lag) for view, lag in zip(views, lags, strict=True)])
    return Consensus(bundle, agree, off, rivals)
