"""Strokes that go round and round, and the single turns they are cut into.

Notation
    s          place along a stroke: arc length measured with a ruler (teach.align), at N even steps; z(s) [px]
    D(P)       RMS of |z(s) - z(s + P)| over the s that have both: small where P is the length of a turn
    c_k        cuts, the places where the stroke is back at its start on the same way
    phi        turns drawn since c_0: phi(c_k) = k, linear in between

A stroke goes round if its turns look alike: for a local minimum P of D, z at phi, phi + 1, ... deviates from its mean
by at most TOLERANCE of a turn's extent (RMS), and it goes round at least MIN_TURNS times. Turns are compared at equal
phi, not at the lag P, because a hand draws no two of them equally long. There-and-back along a line is a turn as well;
a letter, a spiral or a closed line drawn once is none.
"""

from dataclasses import replace

import numpy as np

from teach.align import arc_length
from teach.curve import deviation, extent
from teach.sketch import Stroke

MIN_TURNS = 1.7
"""Times a stroke goes round at least; less is a closed line with an overlap."""
TOLERANCE = 0.15
"""Largest standard deviation of a stroke's turns over the extent of their mean."""
WINDOW = 0.3
"""A turn is shorter or longer than the stroke's others by at most this fraction of them."""
SHORT = 0.15
"""A last turn that ends at most this fraction early counts, and is closed by a straight line."""
APART = 0.25
"""Largest distance of what should be one place, such as both ends of a closed stroke, over the extent of a turn."""
REACH = 0.04
"""Where a stroke goes is told from this part of a turn before and after."""
SAMPLES, PHASES = 800, 50
"""N, and phases at which turns are compared."""


def turns(stroke: Stroke, start=None, once: bool = False) -> list[Stroke]:
    """The single turns of the stroke, in order; none if it does not go round and round.

    start: (2,) [px] where turns begin; None: where the stroke does. once: a closed stroke drawn once round is its own
    turn. Consecutive turns share the point, interpolated, at which they are cut. Events go with the turn of their time,
    those before the first and after the last with these.
    """
    start = stroke.points[0] if start is None else np.asarray(start, dtype=float)
    found = cuts(stroke, start)
    if once and not len(found):
        found = _cuts_once(stroke, start)
    if not len(found):
        return []
    pieces = _pieces(stroke, found)
    pieces[0] = _from(pieces[0], start) if found[0] == 0 else pieces[0]
    pieces[-1] = _to(pieces[-1], start) if found[-1] == 1 else pieces[-1]
    return [replace(piece, demonstration=number) for number, piece in enumerate(pieces)]


def cuts(stroke: Stroke, start=None) -> np.ndarray:
    """c_0, ..., c_n (n + 1,) in [0, 1] of the stroke's n turns; empty if it does not go round and round.

    A c_0 of 0 and a c_n of 1 may lie a little after and before ``start`` (2,) [px]: the pen was late or left early.
    """
    start = stroke.points[0] if start is None else np.asarray(start, dtype=float)
    z = _even(stroke)
    for lag in _lags(z):
        c = _cuts(z, lag, start)
        if len(c) > 1 and _drawn(c) >= MIN_TURNS and _unlike(z, c) <= TOLERANCE:
            return c / (len(z) - 1)
    return np.empty(0)


def _even(stroke: Stroke) -> np.ndarray:
    """z (SAMPLES, 2) [px]."""
    s, even = arc_length(stroke), np.linspace(0, 1, SAMPLES)
    return np.stack([np.interp(even, s, stroke.points[:, axis]) for axis in range(2)], axis=1)


def _lags(z) -> list[int]:
    """Local minima of D [samples], from the shortest on."""
    longest = int((len(z) - 1) / (MIN_TURNS - SHORT))  # of turns that differ in length it may be above their mean
    D = [np.sqrt(((z[lag:] - z[:-lag]) ** 2).sum(axis=1).mean()) for lag in range(1, longest + 2)]
    return [k + 1 for k in range(7, longest) if D[k] <= min(D[k - 1], D[k + 1]) and D[k] < 0.5 * max(D[:k])]


def _cuts(z, lag: int, start) -> np.ndarray:
    """c (n + 1,) [samples]: the first near the stroke's beginning, each other about one lag after the one before."""
    reach = max(1, round(REACH * lag))
    cost, last = _cost(z, extent(z[: lag + 1]), reach, start), len(z) - 1
    c = [_lowest(cost, 0, WINDOW * lag)]
    while c[-1] + (1 - SHORT) * lag <= last:
        c.append(_lowest(cost, c[-1] + (1 - WINDOW) * lag, c[-1] + (1 + WINDOW) * lag))
    return _refined(z, np.array(c), reach, start)


def _cost(z, size: float, reach: int, start) -> np.ndarray:
    """(N,) [px^2]: squared distance from the start, and up to size / 2 more where z does not go the way it starts.

    Within 90 degrees of that way only the distance counts, or cuts would be drawn to where the direction fits best.
    """
    along = _along(z, reach)
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return ((z - start) ** 2).sum(axis=1) + (0.5 * size) ** 2 * np.maximum(-along @ along[0], 0)


def _along(z, reach: int) -> np.ndarray:
    """(N, 2) [px per sample]: the way of z, from ``reach`` samples before to as many after."""
    i = np.arange(len(z))
    before, after = np.maximum(i - reach, 0), np.minimum(i + reach, len(z) - 1)
    return (z[after] - z[before]) / (after - before)[:, None]


def _lowest(cost, low: float, high: float) -> int:
    low = round(low)
    return low + int(np.argmin(cost[low : round(high) + 1]))


def _refined(z, c, reach: int, start) -> np.ndarray:
    """The cuts moved to where a line through their surroundings is nearest to the start, which one trembling point is
    not; those at the ends of the stroke stay, and those at a corner, where there is no such line."""
    along = _along(z, reach)
    squared = (along**2).sum(axis=1)
    refined = c.astype(float)
    for k, i in enumerate(c):
        if (r := min(reach, i, len(z) - 1 - i)) > 0:
            offset = (start - z[i - r : i + r + 1].mean(axis=0)) @ along[i] / max(squared[i], np.median(squared))
            refined[k] += np.clip(offset, -r, r)
    return refined


def _at_phase(c, phi) -> np.ndarray:
    """Places [samples] at phi (...,); beyond the cuts turns are as long as they are on average."""
    n, mean = len(c) - 1, (c[-1] - c[0]) / (len(c) - 1)
    return np.interp(phi, np.arange(-1, n + 2), np.concatenate([[c[0] - mean], c, [c[-1] + mean]]))


def _drawn(c, last: int = SAMPLES - 1) -> float:
    """Turns from the beginning to the end of the stroke; an end that is cut counts as a whole turn."""
    mean = (c[-1] - c[0]) / (len(c) - 1)
    return (len(c) - 1) + (c[0] + last - c[-1]) / mean


def _phased(z, c) -> np.ndarray:
    """z at PHASES even phases of each turn (n + 2, PHASES, 2), turns begun before and after included; nan where not
    drawn."""
    phi = np.arange(-1, len(c))[:, None] + np.arange(PHASES) / PHASES
    place, samples = _at_phase(c, phi), np.arange(len(z))
    x = np.stack([np.interp(place, samples, z[:, axis]) for axis in range(2)], axis=-1)
    return np.where(((place >= 0) & (place <= len(z) - 1))[..., None], x, np.nan)


def _unlike(z, c) -> float:
    """Standard deviation of the turns, over the extent of their mean; only phases drawn twice count."""
    x = _phased(z, c)
    x = x[:, (~np.isnan(x[..., 0])).sum(axis=0) > 1]
    return deviation(x) / extent(np.nanmean(x, axis=0))


def _cuts_once(stroke: Stroke, start) -> np.ndarray:
    """c_0 = 0 and c_1 of a closed stroke, which may overlap itself by less than a turn; empty if it is not closed."""
    z = _even(stroke)
    reach = round(REACH * len(z))
    c = _lowest(_cost(z, extent(z), reach, start), 0.6 * len(z), len(z))
    if np.linalg.norm(z[c] - start) > APART * extent(z):
        return np.empty(0)
    return _refined(z, np.array([0, c]), reach, start) / (len(z) - 1)


def _pieces(stroke: Stroke, found) -> list[Stroke]:
    """The stroke between its cuts (n + 1,), with their interpolated points."""
    number = np.arange(len(stroke.points))
    indices = np.interp(found, arc_length(stroke), number)
    indices = np.where(found == 0, 0, np.where(found == 1, number[-1], indices))  # a pen that rests is part of the turn
    inner = np.interp(indices[1:-1], number, stroke.times)
    owner = np.searchsorted(inner, [event.time for event in stroke.events], side="right")
    return [
        piece(stroke, i, j, tuple(event for event, its in zip(stroke.events, owner, strict=True) if its == k))
        for k, (i, j) in enumerate(zip(indices[:-1], indices[1:], strict=True))
    ]


def piece(stroke: Stroke, i: float, j: float, events) -> Stroke:
    """The stroke from its i-th to its j-th point, both fractional and interpolated."""
    index = np.concatenate([[i], np.arange(np.floor(i) + 1, np.ceil(j)), [j]])
    at = lambda values: np.interp(index, np.arange(len(values)), values)
    points = np.stack([at(column) for column in stroke.points.T], axis=1)
    pressure = None if stroke.pressure is None else at(stroke.pressure)
    return replace(stroke, points=points, times=at(stroke.times), pressure=pressure, events=events)


def _to(turn: Stroke, point) -> Stroke:
    """The turn with a straight line to ``point`` (2,) [px] at its end, drawn at its mean speed."""
    gap = np.linalg.norm(point - turn.points[-1])
    if gap == 0:
        return turn
    times = np.append(turn.times, turn.times[-1] + turn.duration * gap / turn.length)
    pressure = None if turn.pressure is None else np.append(turn.pressure, turn.pressure[-1])
    return replace(turn, points=np.concatenate([turn.points, [point]]), times=times, pressure=pressure)


def _from(turn: Stroke, point) -> Stroke:
    """The turn with a straight line from ``point`` (2,) [px] at its beginning, drawn at its mean speed."""
    return _reversed(_to(_reversed(turn), point))


def _reversed(stroke: Stroke) -> Stroke:
    pressure = None if stroke.pressure is None else stroke.pressure[::-1]
    return replace(stroke, points=stroke.points[::-1], times=-stroke.times[::-1], pressure=pressure)
