"""A mesh as few convex pieces that cover it and cover no space that is known to be free.

Notation
    forbidden   points of free space; a piece may contain none of them
    hull        of a part of the mesh: its convex hull, with the surface thickened to the inside

Parts are cut in two, along the axis and at the place that leave the fewest forbidden points inside the two hulls, until
none is left; then neighbours are joined again wherever their common hull contains none either. What lies behind a
surface is not known to be free, so things become solid, whereas hollows that were looked into stay open. """

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

PLACES = 5
"""Where a part may be cut along each axis."""
COUNTED = 2000
"""Forbidden points by which cuts are compared; whether any is left is asked of all."""


@dataclass(frozen=True, eq=False)
class _Part:
    """faces: (F,) numbers; hull: of their thickened corners; inside: (K, 3) the forbidden points in it."""

    faces: np.ndarray
    hull: ConvexHull
    inside: np.ndarray

    @property
    def bounds(self) -> np.ndarray:
        return np.stack([self.hull.points[self.hull.vertices].min(0), self.hull.points[self.hull.vertices].max(0)])


def convex_pieces(
    vertices: np.ndarray, faces: np.ndarray, forbidden: np.ndarray, thickness: float, smallest: float
) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Convex meshes (vertices (V, 3), faces (F, 3), anticlockwise from outside) whose union covers the mesh.

    vertices (V, 3) and faces (F, 3): the mesh; forbidden: (N, 3) points. thickness: by which surfaces are thickened to
    the inside; smallest: parts of less extent are cut no further, whatever they contain. All lengths in one unit. """
    normals = _normals(vertices, faces)
    solid = np.concatenate([vertices, vertices - thickness * normals])
    middles = vertices[faces].mean(1)
    corners = lambda some: solid[np.concatenate([used := np.unique(faces[some]), used + len(vertices)])]
    forbidden = forbidden[np.argsort(forbidden[:, 0])]
    whole = _part(np.arange(len(faces)), corners(slice(None)), forbidden)
    done, waiting = [], [whole]
    while waiting:
        part = waiting.pop()
        if len(part.inside) and np.ptp(part.bounds, axis=0).max() > smallest and len(part.faces) > 1:
            waiting += _cut(part, middles, corners)
        else:
            done.append(part)
    return tuple(_mesh(part.hull) for part in _joined(done, forbidden))


def _cut(part: _Part, middles, corners) -> list[_Part]:
    """The two parts that contain the fewest forbidden points; of equal cuts the most even one."""
    best, least = None, (np.inf, np.inf)
    counted = part.inside[:: len(part.inside) // COUNTED + 1]
    for axis in range(3):
        along = middles[part.faces, axis]
        for place in np.linspace(along.min(), along.max(), PLACES + 2)[1:-1]:
            below = along < place
            if not 0 < below.sum() < len(below):
                continue
            pair = [_part(part.faces[side], corners(part.faces[side]), counted) for side in (below, ~below)]
            cost = sum(len(half.inside) for half in pair), max(np.prod(np.ptp(half.bounds, axis=0)) for half in pair)
            if cost < least:
                best, least = [half.faces for half in pair], cost
    halves = best or np.array_split(part.faces, 2)  # the latter where all faces are in one place
    return [_part(half, corners(half), part.inside) for half in halves]


def _joined(parts: Sequence[_Part], forbidden: np.ndarray) -> list[_Part]:
    """Neighbours are joined, the smallest parts first, as long as their common hull contains no forbidden point."""
    parts, tried = list(parts), set()
    while True:
        parts.sort(key=lambda part: part.hull.volume)
        pair = next((p for p in _touching(parts) if (id(p[0].hull), id(p[1].hull)) not in tried), None)
        if pair is None:
            return parts
        a, b = pair
        tried.add((id(a.hull), id(b.hull)))
        points = np.concatenate([p.hull.points[p.hull.vertices] for p in pair])
        both = _part(np.concatenate([a.faces, b.faces]), points, forbidden)
        if len(both.inside) <= max(len(a.inside), len(b.inside)):
            parts = [p for p in parts if p is not a and p is not b] + [both]


def _touching(parts: Sequence[_Part]):
    """Pairs whose boxes meet."""
    bounds = np.array([part.bounds for part in parts])
    for i, part in enumerate(parts):
        meet = ((bounds[:, 0] <= bounds[i, 1] + 1e-9) & (bounds[:, 1] >= bounds[i, 0] - 1e-9)).all(1)
        yield from ((part, parts[j]) for j in np.flatnonzero(meet) if j > i)


def _part(faces, points, forbidden) -> _Part:
    """forbidden: in the order of their x."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat, however thickened
        hull = ConvexHull(points, qhull_options="QJ")
    low, high = points.min(0), points.max(0)
    near = forbidden[slice(*np.searchsorted(forbidden[:, 0], [low[0], high[0]]))]
    near = near[((near[:, 1:] > low[1:]) & (near[:, 1:] < high[1:])).all(1)]
    for rows in np.array_split(hull.equations, len(hull.equations) // 16 + 1):
        near = near[(near @ rows[:, :3].T + rows[:, 3] < 0).all(1)] if len(near) else near
    return _Part(faces, hull, near)


def _mesh(hull: ConvexHull) -> tuple[np.ndarray, np.ndarray]:
    """The hull's own vertices and faces, each anticlockwise from outside."""
    number = np.full(len(hull.points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    vertices, faces = hull.points[hull.vertices], number[hull.simplices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return vertices, faces


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals of the vertices, outwards, weighted by the faces' areas."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], np.cross(b - a, c - a))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
