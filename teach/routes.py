"""More than one way: strokes that pass an obstacle on different sides are different motions, not one between them.

    strokes of a view ─ evidence of each grouping ─ routes ─ which group of a view is which of another ─ sketches per route

Notation
    X_i = m + d_k(i) + s e_i    stroke i of a view at even arc length; m flat; k(i) its group
    e_i ~ N(0, E)                 what a hand does (teach.bundle.hand_faults) and trembles; s its sloppiness, log-normal
    d_k ~ N(0, a^2 D)             how a route differs: smooth, 0 at both ends, of the size a, one of SIZES of the extent

In coordinates in which E = I and D is diagonal the evidence of a grouping is in closed form but for sums over s and a.
All views have the same number of routes, so that their evidence adds up, whereas a view may not tell them apart. Groups
of two views are matched by the evidence that they show one curve (teach.bundle); where that leaves it open, as epipolar
geometry may, by the strokes' demonstration numbers, else by the order in which they were drawn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.special import logsumexp

from teach.align import arc_length, resample, viewed
from teach.bundle import BENDS, COUNT, LAGS, ViewedStroke, hand_faults, pinned, solve, starts
from teach.curve import extent
from teach.likelihood import correlation
from teach.sketch import Sketch

MOST = 3
PRIOR = (0.0, -13.0, -26.0)
"""Log probability of one route, of two and of three, before anything is seen: as improbable as it takes, since the hand
is only a model of one. Strokes of one letter that a person drew, or of a hand twice as sloppy, reach a log evidence of 10
for two routes; two ways round an obstacle have 25 to 170."""
USUAL = 12
"""Number of strokes from which on the prior grows with them, as what the model of the hand has wrong does."""
SLOPPINESS, SIZES = np.geomspace(0.35, 4.0, 12), (0.1, 0.2, 0.4)
"""Values of s, log-normal around 1 with the deviation SPREAD, and of a over the extent, that are summed over."""
SPREAD = 0.5
TREMBLING, PIXELS, LENGTH = 0.01, 2.0, 0.2
"""Of the extent and in pixels, what a hand does that is not smooth; correlation length of a route's difference."""
EVERY, MODES = 4, 6
"""Of the COUNT points of a stroke, each so many-th is looked at; of a hand's faults the largest so many of each axis."""
ENUMERATED = 8
"""Up to so many strokes all groupings are tried; of more those of a hierarchical clustering and their neighbours."""
APART = 4.0
"""Groups are routes from this distance on: where hands are not what the model has, evidence alone cuts a wide bundle."""
SURE = 40.0
"""Log evidence from which on a matching of groups is clear. The hand is only a model: of 32 scripted pairs of routes wrong
matchings had up to 25 more than right ones, and right ones up to 220 more than wrong ones."""

LEAST = -1e6
"""Log evidence of strokes that show no curve in front of both cameras."""


def split(sketches: Sequence[Sketch]) -> tuple[list[list[Sketch]], list[str]]:
    """For each route the sketches with its strokes alone, most strokes first, and sentences on what is uncertain.

    A view from which routes look the same lends its strokes to all of them. A single stroke that goes its own way on one
    view alone is left out.
    """
    groups = grouped(sketches)
    first = max(range(len(sketches)), key=lambda v: len(groups[v]))
    if len(groups[first]) == 1:
        return [list(sketches)], []
    if (slip := _slip(groups)) is not None:
        return _without(sketches, *slip)
    notes, parts = [], [[_part(sketch, group) for group in view] for sketch, view in zip(sketches, groups, strict=True)]
    chosen = [[None] * len(sketches) for _ in groups[first]]
    for v, part in enumerate(parts):
        order, clear = (range(len(part)), True) if v == first else _matched(parts[first], part)
        for route, k in enumerate(order):
            chosen[route][v] = part[k]
        if not clear:
            notes.append(f"Which way on view {sketches[first].view} is which on view {sketches[v].view} is not clear from the "
                         "views; the order of drawing was taken: number the demonstrations if it is the other way.")  # fmt: skip
    chosen.sort(key=lambda route: -sum(len(sketch.motions) for sketch in route))
    return chosen, notes


def grouped(sketches: Sequence[Sketch]) -> list[list[list[int]]]:
    """For each view the indices of its motion strokes by route, in the order of drawing; one group where the view does
    not tell routes apart."""
    found = [_evidence(sketch) for sketch in sketches]
    often = max(1.0, sum(len(sketch.motions) for sketch in sketches) / USUAL)
    total = [often * PRIOR[routes - 1] + sum(max(log for log, _ in view[:routes]) for view in found) for routes in range(1, MOST + 1)]
    routes = int(np.argmax(total)) + 1
    return [max(view[:routes], key=lambda one: one[0])[1] for view in found]


def _evidence(sketch: Sketch) -> list[tuple[float, list[list[int]]]]:
    """For 1, 2, ... groups of the view's strokes the log evidence over that of a single group, and the best grouping."""
    strokes = np.stack([resample(stroke, arc_length(stroke), COUNT) for stroke in sketch.motions])
    count, found = len(strokes), [(0.0, [list(range(len(strokes)))])]
    if count == 1:
        return found
    y, scale = _coordinates(strokes)
    alone = _log_evidence(y, scale, np.zeros(count, dtype=int))
    for groups in range(2, min(MOST, count) + 1):
        labelings = list(_labelings(count, groups)) if count <= ENUMERATED else _clustered(y, scale, groups)
        logs = np.array([_log_evidence(y, scale, labels) for labels in labelings]) - alone
        best = labelings[int(np.argmax(logs))]
        if _separation(y, best) < APART:
            continue
        members = sorted((np.flatnonzero(best == k).tolist() for k in range(groups)), key=lambda group: group[0])
        prior = np.log(groups) * (count - 1) - sum(np.log(range(2, groups)))  # about how many groupings there are
        found.append((float(logsumexp(logs) - prior), members))
    return found


def _separation(y, labels) -> float:
    """Least distance of two groups' means over the deviation within groups in that direction. Strokes that vary evenly,
    cut in the middle, have 2.7."""
    least = np.inf
    for a, b in combinations(np.unique(labels), 2):
        one, other = y[labels == a], y[labels == b]
        way = one.mean(axis=0) - other.mean(axis=0)
        along = np.concatenate([group - group.mean(axis=0) for group in (one, other)]) @ way / max(np.linalg.norm(way), 1e-300)
        within = ((along**2).sum() + 2) / len(along)  # with what two strokes of a usual hand would add
        least = min(least, float(np.linalg.norm(way) / np.sqrt(within)))
    return least


def _coordinates(strokes) -> tuple[np.ndarray, np.ndarray]:
    """The strokes (n, COUNT, 2) in coordinates (n, J) in which a hand's faults have variance 1, and the variances (J,)
    in them of a route's difference of the size of the extent. What trembling hides is left away, or a calm pen would
    make a sloppy hand look exact."""
    mean, u = strokes.mean(axis=0), np.linspace(0, 1, COUNT)[::EVERY]
    size = max(extent(mean), 1.0)
    floor = (TREMBLING * size) ** 2 + PIXELS**2
    difference = size**2 / 2 * pinned(correlation(u, LENGTH))
    y, scale = [], []
    for axis, faults in enumerate(hand_faults(mean)):
        variances, vectors = np.linalg.eigh(faults[::EVERY, ::EVERY])
        kept = np.argsort(variances)[-MODES:]
        white = vectors[:, kept] / np.sqrt(variances[kept] + floor)
        variances, vectors = np.linalg.eigh(white.T @ difference @ white)
        y.append((strokes[:, ::EVERY, axis] - mean[::EVERY, axis]) @ white @ vectors)
        scale.append(variances.clip(0))
    return np.concatenate(y, axis=1), np.concatenate(scale)


def _log_evidence(y, scale, labels) -> float:
    """log p(y | grouping) up to a constant of y (n, J). scale: (J,), variances of a route's difference; labels: (n,)."""
    size = np.bincount(labels).astype(float)
    mean = np.stack([y[labels == k].mean(axis=0) for k in range(len(size))])
    within = ((y - mean[labels]) ** 2).sum()
    s2, a2 = SLOPPINESS[:, None] ** 2, np.array(SIZES) ** 2
    n = size[:, None, None, None]
    spread = s2[..., None] + n * (a2[:, None] * scale)  # (K, s, a, J): n_k times the variance of a group's mean
    weight = n / spread
    centre = (weight * mean[:, None, None]).sum(axis=0) / weight.sum(axis=0)
    log = -0.5 * (weight * (mean[:, None, None] - centre) ** 2 + np.log(spread)).sum(axis=(0, -1))
    log -= 0.5 * np.log(weight.sum(axis=0)).sum(axis=-1)
    log -= 0.5 * (within / s2 + (len(y) - len(size)) * y.shape[1] * np.log(s2))
    return float(logsumexp(log - np.log(SLOPPINESS[:, None]) ** 2 / (2 * SPREAD**2)) - np.log(len(SIZES)))


def _labelings(count: int, groups: int) -> Iterator[np.ndarray]:
    """All groupings of ``count`` strokes into so many groups, each once; groups are numbered as they appear."""

    def grow(labels, used):
        if len(labels) == count:
            if used == groups:
                yield np.array(labels)
            return
        for k in range(min(used + 1, groups)):
            yield from grow([*labels, k], max(used, k + 1))

    return grow([], 0)


def _clustered(y, scale, groups: int) -> list[np.ndarray]:
    """Groupings (n,) near those of hierarchical clustering: single strokes change groups while that raises the
    evidence."""
    found = []
    for method in ("average", "ward"):
        labels = fcluster(linkage(y * np.sqrt(scale / (1 + scale)), method), groups, criterion="maxclust") - 1
        if len(np.unique(labels)) < groups:
            continue
        log, better = _log_evidence(y, scale, labels), True
        while better:
            better = False
            for i, k in product(range(len(y)), range(groups)):
                moved = np.where(np.arange(len(y)) == i, k, labels)
                if len(np.unique(moved)) == groups and (new := _log_evidence(y, scale, moved)) > log + 1e-9:
                    labels, log, better = moved, new, True
        found.append(labels)
    return found or [np.minimum(np.arange(len(y)), groups - 1)]


def _slip(groups) -> tuple[int, int] | None:
    """(view, stroke) of the only stroke that goes another way, where no other view knows of one and its own has
    more than two."""
    apart = [v for v, view in enumerate(groups) if len(view) > 1]
    if len(groups) == 1 or len(apart) > 1 or len(groups[apart[0]]) != 2:
        return None
    small, large = sorted(groups[apart[0]], key=len)
    return (apart[0], small[0]) if len(small) == 1 < len(large) else None


def _without(sketches, view: int, stroke: int) -> tuple[list[list[Sketch]], list[str]]:
    kept = list(sketches)
    kept[view] = _part(kept[view], [k for k in range(len(kept[view].motions)) if k != stroke])
    return [kept], [f"Stroke {stroke + 1} on view {kept[view].view} goes another way than the others there, and no other view shows "
                    "that way; it is left out: if it is meant, draw it on two views."]  # fmt: skip


def _part(sketch: Sketch, group) -> Sketch:
    return replace(sketch, strokes=tuple(sketch.motions[k] for k in group))


def _matched(reference: Sequence[Sketch], other: Sequence[Sketch]) -> tuple[list[int], bool]:
    """For each route of a view the group of another view that shows it, and whether that is clear."""
    if len(other) == 1:
        return [0] * len(reference), True
    a, b = ([viewed(part, [arc_length(stroke) for stroke in part.motions]) for part in parts] for parts in (reference, other))
    evidence = np.array([[_agreement(x, y) for y in b] for x in a])
    routes = range(len(a))
    ways = list(permutations(range(len(b)))) if len(a) == len(b) else list(product(range(len(b)), repeat=len(a)))
    totals = {way: sum(evidence[k, way[k]] for k in routes) for way in ways if len(set(way)) == len(b)}
    best = max(totals, key=totals.get)
    if totals[best] >= SURE + max(total for way, total in totals.items() if way != best):
        return list(best), True
    numbers = [[{stroke.demonstration for stroke in part.motions} for part in parts] for parts in (reference, other)]
    same = [way for way in totals if all(numbers[0][k] == numbers[1][way[k]] for k in routes)]
    if len(same) == 1 and not (_numbered_as_drawn(reference) and _numbered_as_drawn(other)):
        return list(same[0]), True
    return [min(k, len(b) - 1) for k in routes], False


def _numbered_as_drawn(parts: Sequence[Sketch]) -> bool:
    """Whether the demonstrations' numbers only count them: then they say no more than the order of drawing."""
    numbers = sorted(stroke.demonstration for part in parts for stroke in part.motions)
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def _agreement(a: ViewedStroke, b: ViewedStroke) -> float:
    """Log evidence that two views' strokes show one curve; LEAST where they show none in front of both cameras."""
    found = [LEAST]
    for lags in starts(a, b):
        try:
            found.append(solve([a, b], lags, LAGS[1], BENDS[2]).evidence)
        except (np.linalg.LinAlgError, ValueError):
            continue
    return max(log for log in found if np.isfinite(log))
