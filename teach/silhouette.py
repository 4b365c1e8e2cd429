"""What a hand-drawn outline encloses, as a few convex polygons.

Notation
    outline      (N, 2) [px], closed by the line from its end to its start; it may cross itself and go round twice
    silhouette   the pixels round which the outline winds not zero times (the union of its loops, not even-odd: a loop
                 that is drawn twice, or whose end runs past its start, encloses what it seems to)
    parts        convex polygons whose union contains the silhouette

The silhouette is cut into trapezoids along the rows of its corners and crossings; they are merged, the pair that
enlarges them least first (approximate convex decomposition, after Lien and Amato 2004), so that the small dents of a
trembling hand do not make a part each. Nothing that was enclosed is ever lost: parts only grow.
"""

from itertools import pairwise

import cv2
import numpy as np

CLOSED = 0.2
"""Share of an outline's length that the gap between its ends may be: five sixths of a circle are closed."""
SIMPLIFIED = 0.5
"""Corners nearer to the line without them are left out [px], farther ones where they are too many; parts are grown by
as much."""
MOST_CORNERS, MOST_CROSSINGS, MOST_PARTS = 300, 100, 8
SMALLEST = 4.0
"""Less is not an area but a line or a point [px^2]."""


def convex_parts(outline, filled: float = 0.0) -> list[np.ndarray]:
    """Convex polygons (C, 2) [px], anticlockwise in (u, v), whose union contains the silhouette of ``outline`` (N, 2).

    Their areas exceed the silhouette's by at most a band of width ``filled`` [px] along its convex hull, more only
    where that would leave above MOST_PARTS parts; then each is grown by what simplifying may have cut off (SIMPLIFIED).
    Raises ValueError where the outline is open, encloses nothing or is a scribble.
    """
    polygon, off = corners(outline)
    parts = trapezoids(polygon)
    if sum(map(area, parts)) < SMALLEST:
        raise ValueError("encloses nothing: draw a closed line around the region")
    eighths = np.pi / 8 + np.arange(8) * np.pi / 4
    disc = off / np.cos(np.pi / 8) * np.column_stack([np.cos(eighths), np.sin(eighths)])
    around = hull(np.vstack(parts))
    band = filled * np.linalg.norm(np.roll(around, -1, axis=0) - around, axis=1).sum()
    return [hull((part[:, None] + disc).reshape(-1, 2)) for part in _merged(parts, band)]


def corners(outline) -> tuple[np.ndarray, float]:
    """At most MOST_CORNERS corners (M, 2) [px] of an outline, and how far [px] from the line through them those are
    that were left out (Douglas and Peucker 1973). Raises ValueError where the outline is not closed."""
    outline = np.asarray(outline, dtype=float)
    length = np.linalg.norm(np.diff(outline, axis=0), axis=1).sum()
    gap = np.linalg.norm(outline[-1] - outline[0])
    if gap > CLOSED * length:
        raise ValueError(f"is not closed: its ends are {gap:.0f} px apart, its length is {length:.0f} px; draw it on "
                         "to where it started")
    kept, off = outline, SIMPLIFIED / 2
    while off < SIMPLIFIED or len(kept) > MOST_CORNERS:
        off *= 2
        kept = cv2.approxPolyDP(outline.astype(np.float32)[:, None], off, closed=True)[:, 0]
    return kept.astype(float), off


def trapezoids(polygon) -> list[np.ndarray]:
    """The silhouette of a closed polygon (M, 2), which may cross itself, cut along rows: disjoint (C, 2) polygons.
    Raises ValueError."""
    start, end = polygon, np.roll(polygon, -1, axis=0)
    levels = np.unique(np.concatenate([polygon[:, 1], _crossing_rows(start, end)]))
    levels = levels[np.diff(levels, prepend=-np.inf) > 1e-9]
    pieces, begun = [], {}
    for low, high in pairwise(levels):
        spans = _spans(start, end, (low + high) / 2)
        pieces += [_between(start, end, *span, begun[span], low) for span in begun if span not in spans]
        begun = {span: begun.get(span, low) for span in spans}
    pieces += [_between(start, end, *span, low, levels[-1]) for span, low in begun.items()]
    return [piece for piece in map(hull, pieces) if len(piece) > 2]


def _crossing_rows(start, end) -> np.ndarray:
    """v [px] of the points where the edges of a polygon cross each other."""
    a, b = np.triu_indices(len(start), 2)
    along = end - start
    across, offset = _cross(along[a], along[b]), start[b] - start[a]
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = _cross(offset, along[b]) / across, _cross(offset, along[a]) / across
    meet = (s > 0) & (s < 1) & (t > 0) & (t < 1)
    if meet.sum() > MOST_CROSSINGS:
        raise ValueError(f"crosses itself {meet.sum()} times (at most {MOST_CROSSINGS}): draw a simple loop")
    return start[a[meet], 1] + s[meet] * along[a[meet], 1]


def _spans(start, end, row) -> list[tuple[int, int]]:
    """The edges (left, right) between which a row [px] runs inside the silhouette."""
    edges = np.flatnonzero((start[:, 1] < row) != (end[:, 1] < row))
    edges = edges[np.argsort(_at(start, end, edges, row))]
    spans, winding = [], 0
    for edge in edges.tolist():
        before, winding = winding, winding + (1 if end[edge, 1] > start[edge, 1] else -1)
        if before == 0:
            left = edge
        elif winding == 0:
            spans.append((left, edge))
    return spans


def _between(start, end, left, right, low, high) -> np.ndarray:
    """The trapezoid (4, 2) between two edges and two rows."""
    return np.array([[_at(start, end, edge, row), row] for edge in (left, right) for row in (low, high)])


def _at(start, end, edge, row):
    """u where an edge crosses a row [px]."""
    share = (row - start[edge, 1]) / (end[edge, 1] - start[edge, 1])
    return start[edge, 0] + share * (end[edge, 0] - start[edge, 0])


def _merged(parts, excess) -> list[np.ndarray]:
    """Fewer parts, whose areas sum to at most ``excess`` [px^2] more where they are no more than MOST_PARTS."""
    parts, areas = dict(enumerate(parts)), {k: area(part) for k, part in enumerate(parts)}
    limit = sum(areas.values()) + excess + 1e-6
    pairs = {(a, b): _joined(parts[a], parts[b]) for a, b in _touching(list(parts.values()))}
    while pairs:
        (a, b), (joined, size) = min(pairs.items(), key=lambda item: item[1][1] - areas[item[0][0]] - areas[item[0][1]])
        if sum(areas.values()) - areas[a] - areas[b] + size > limit and len(parts) <= MOST_PARTS:
            break
        near = {k for pair in pairs if a in pair or b in pair for k in pair} - {a, b}
        pairs = {pair: kept for pair, kept in pairs.items() if a not in pair and b not in pair}
        parts[a], areas[a] = joined, size
        del parts[b], areas[b]
        pairs |= {(a, k): _joined(parts[a], parts[k]) for k in near}
    return list(parts.values())


def _joined(a, b) -> tuple[np.ndarray, float]:
    joined = hull(np.vstack([a, b]))
    return joined, area(joined)


def _touching(pieces) -> list[tuple[int, int]]:
    """The pairs of trapezoids of which one ends in the row where the other begins, and there they share a point."""
    begin, end = (np.array([_side(piece, row(piece[:, 1])) for piece in pieces]).T for row in (np.min, np.max))
    same_row = np.abs(end[0][:, None] - begin[0]) < 1e-6
    overlap = (end[1][:, None] <= begin[2] + 1e-6) & (begin[1] <= end[2][:, None] + 1e-6)
    return [(a, b) for a, b in np.argwhere(same_row & overlap).tolist() if a != b]


def _side(piece, row) -> tuple[float, float, float]:
    """The row and the extent in it of a trapezoid's side."""
    on_row = piece[np.abs(piece[:, 1] - row) < 1e-6, 0]
    return row, on_row.min(), on_row.max()


def hull(points) -> np.ndarray:
    """Convex hull (C, 2) of points (N, 2), anticlockwise in (u, v) (Andrew's monotone chain)."""
    ordered = sorted(set(map(tuple, np.asarray(points, dtype=float).tolist())))
    return np.array(_chain(ordered)[:-1] + _chain(ordered[::-1])[:-1]).reshape(-1, 2)


def _chain(points) -> list:
    chain = []
    for p in points:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
            chain.pop()
        chain.append(p)
    return chain


def _turn(a, b, c) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def area(polygon) -> float:
    """Signed area [px^2] of a polygon (C, 2), positive where it is anticlockwise in (u, v)."""
    return float(_cross(polygon, np.roll(polygon, -1, axis=0)).sum() / 2)


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
