"""More than one way: strokes that pass an obstacle on different sides are different motions, not one between them.

    strokes of a view ─ D_ij ─ groups ─ which group of a view is which of another ─ one set of sketches per route

D_ij is the RMS distance of two strokes over what a hand's repetitions of one stroke would have. Groups are matched by
how well their strokes meet; where both ways meet equally well, which epipolar geometry alone cannot tell, by the
strokes' demonstration numbers, else by the order in which they were drawn.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from teach.align import arc_length, resample, viewed
from teach.bundle import COUNT, ViewedStroke, hand_faults
from teach.epipolar import fundamental, lag_between
from teach.sketch import Sketch

APART, ALONE = 2.2, 4.0
"""Groups are different routes from this many times the distance within them on, but for a group of a single stroke."""
MOST = 3
CLEAR = 0.5
"""A matching of groups is clear if it costs at most this share of any other."""


def split(sketches: Sequence[Sketch]) -> tuple[list[list[Sketch]], list[str]]:
    """For each route the sketches with its strokes alone, most strokes first, and sentences on what is uncertain.

    A view from which routes look the same lends its strokes to all of them.
    """
    groups = [_groups(sketch) for sketch in sketches]
    first = max(range(len(sketches)), key=lambda v: len(groups[v]))
    if len(groups[first]) == 1:
        return [list(sketches)], []
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


def _groups(sketch: Sketch) -> list[list[int]]:
    """Indices of the motion strokes of each route that the view can tell apart, in the order of drawing."""
    strokes = np.stack([resample(stroke, arc_length(stroke), COUNT) for stroke in sketch.motions])
    if len(strokes) == 1:
        return [[0]]
    fault = np.sqrt(2 * np.trace(hand_faults(strokes[0]), axis1=1, axis2=2).sum() / COUNT)  # of two strokes
    D = np.sqrt(((strokes[:, None] - strokes[None]) ** 2).sum(-1).mean(-1)) / fault
    tree = linkage(squareform(D, checks=False), method="average")
    for count in range(min(MOST, len(strokes)), 1, -1):
        labels = fcluster(tree, count, criterion="maxclust")
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        if len(groups) == count and _apart(D, groups):
            return sorted((group.tolist() for group in groups), key=lambda group: group[0])
    return [list(range(len(strokes)))]


def _apart(D, groups) -> bool:
    """Whether all groups are further from each other than from themselves, and than hands stray."""
    for k, a in enumerate(groups):
        for b in groups[:k]:
            within = max(1.0, *(D[np.ix_(g, g)].sum() / max(len(g) * (len(g) - 1), 1) for g in (a, b)))
            if D[np.ix_(a, b)].mean() < (ALONE if min(len(a), len(b)) == 1 else APART) * within:
                return False
    return True


def _part(sketch: Sketch, group) -> Sketch:
    return replace(sketch, strokes=tuple(sketch.motions[k] for k in group))


def _matched(reference: Sequence[Sketch], other: Sequence[Sketch]) -> tuple[list[int], bool]:
    """For each route of a view the group of another view that shows it, and whether that is clear."""
    if len(other) == 1:
        return [0] * len(reference), True
    a, b = ([viewed(part, [arc_length(stroke) for stroke in part.motions]) for part in parts] for parts in (reference, other))
    cost = np.array([[_disagreement(x, y) for y in b] for x in a])
    routes = range(len(a))
    ways = list(permutations(range(len(b)))) if len(a) == len(b) else list(product(range(len(b)), repeat=len(a)))
    totals = {way: sum(cost[k, way[k]] for k in routes) for way in ways if len(set(way)) == len(b)}
    best = min(totals, key=totals.get)
    rest = [total for way, total in totals.items() if way != best]
    if totals[best] <= CLEAR * min(rest):
        return list(best), True
    numbers = [[{stroke.demonstration for stroke in part.motions} for part in parts] for parts in (reference, other)]
    same = [way for way in totals if all(numbers[0][k] == numbers[1][way[k]] for k in routes)]
    return (list(same[0]), True) if len(same) == 1 else ([min(k, len(b) - 1) for k in routes], False)


def _disagreement(a: ViewedStroke, b: ViewedStroke) -> float:
    """Mean squared distance of two views' strokes from meeting, over that of hands."""
    F, sigma = fundamental(a.camera, b.camera), np.hypot(a.sigma, b.sigma) / np.sqrt(2)
    return min(lag_between(a.mean, b.mean, F, sigma, size)[1] for size in (0.12, 0.5))
