"""Regions to keep out of: outlines on two or more views -> their visual hull (Laurentini 1994).

Notation
    silhouette   what an outline encloses in its view (silhouette.py), as convex polygons
    cone         the points seen inside such a polygon: for each edge, from pixel p to pixel q anticlockwise,
                     (p x q)^T P x >= 0          p, q, x homogeneous; P: (3, 4) the camera's projection
                 The edges' half-spaces together leave nothing behind the camera.
    hull         the intersection of the views' silhouettes' cones; a union of convex pieces, one for each choice of a
                 polygon per view whose cones meet

A point is in the hull if and only if every view sees it inside the silhouette, to within a pixel and what silhouette.py
fills; so the hull contains everything that was outlined, and it is larger where a hollow shows in no view.

    for region in visual_hull(sketches): region.name, region.volume, region.contains(points)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

from scene.camera import Camera
from teach.silhouette import convex_parts
from teach.sketch import Sketch, SketchError

FILLED = 0.003
"""Width of the band along an outline that may be filled, as share of the picture's: a hand's tremor (hand.py)."""
THINNEST = 1e-4
"""Pieces into which no ball of this radius fits [m] are left out."""
FARTHEST = 40.0
"""Rays that meet farther away than this many times half the cameras' distance cross at less than 3 degrees."""
SMOOTH = np.cos(np.radians(3))


@dataclass(frozen=True, eq=False)
class Region:
    """A volume in the world, as a union of convex pieces. pieces: (vertices (V, 3) [m], faces (F, 3)) each, faces
    anticlockwise from outside."""

    name: str
    pieces: tuple[tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]], ...]

    @property
    def volume(self) -> float:
        """[m^3] of all pieces; slivers in which pieces overlap count for each of them."""
        return float(sum(np.linalg.det((v - v.mean(axis=0))[faces]).sum() / 6 for v, faces in self.pieces))

    def contains(self, points) -> np.ndarray:
        """(...,) bool: which points (..., 3) [m] lie in the region or on its surface."""
        points = np.asarray(points, dtype=float)
        inside = np.zeros(points.shape[:-1], dtype=bool)
        for vertices, faces in self.pieces:
            normals = _normals(vertices, faces)
            heights = points @ normals.T - (vertices[faces[:, 0]] * normals).sum(axis=1)
            inside |= (heights <= 1e-9).all(axis=-1)
        return inside

    @property
    def edges(self) -> np.ndarray:
        """(E, 2, 3) [m] ends of the pieces' edges, for showing; none between faces of one plane."""
        return np.concatenate([vertices[_sharp(vertices, faces)] for vertices, faces in self.pieces])


def visual_hull(sketches: Sequence[Sketch], *, filled: float = FILLED) -> tuple[Region, ...]:
    """The regions that the keep-out strokes of ``sketches`` outline, in the world's frame; none without such strokes.

    Where each view has one outline, all are of one region. Where a view has several, outlines with the same
    ``demonstration`` are of one region, and those of one view are joined. filled: how much dents of outlines may be
    filled for the sake of fewer pieces (FILLED). Raises SketchError where an outline is not closed, a region is
    outlined on one view only, or the views' cones do not meet or enclose nothing that ends.
    """
    outlined = [sketch for sketch in sketches if sketch.outlines]
    names = sorted({sketch.view for sketch in outlined})
    if len(names) < len(outlined):
        raise SketchError(f"{len(outlined)} sketches share the views {names}: put all strokes of a view in one sketch")
    if all(len(sketch.outlines) == 1 for sketch in outlined):
        return (_region("keep-out region", outlined, filled),) if outlined else ()
    numbers = sorted({stroke.demonstration for sketch in outlined for stroke in sketch.outlines})
    title = "keep-out region {}" if len(numbers) > 1 else "keep-out region"
    return tuple(_region(title.format(k), _of(outlined, n), filled) for k, n in enumerate(numbers, start=1))


def _of(outlined, number: int) -> list[Sketch]:
    """The sketches with only the outlines of one region."""
    kept = [(s, tuple(stroke for stroke in s.outlines if stroke.demonstration == number)) for s in outlined]
    return [Sketch(sketch.view, sketch.camera, strokes) for sketch, strokes in kept if strokes]


def _region(name: str, outlined, filled: float) -> Region:
    if len(outlined) < 2:
        raise SketchError(
            f"the {name} is outlined only on view {outlined[0].view!r}, so it has no end in depth: outline it on a "
            "second view from another side, with the same number (demonstration) where there are several regions"
        )
    cones = [[_cone(sketch.camera, part) for part in _parts(name, sketch, filled)] for sketch in outlined]
    middle = np.mean([sketch.camera.centre for sketch in outlined], axis=0)
    reach = FARTHEST * max(np.linalg.norm(sketch.camera.centre - middle) for sketch in outlined)
    if reach < 1e-6:
        raise _endless(name, outlined)
    bounds = np.concatenate([np.eye(3), -np.eye(3)])
    bounds = np.column_stack([bounds, -bounds @ middle - reach])
    met = _meeting(cones, bounds)
    if not met:
        raise _apart(name, outlined, cones, bounds)
    pieces = tuple(_piece(halfspaces, inside) for halfspaces, inside in met)
    if max(np.abs(vertices - middle).max() for vertices, _ in pieces) > 0.999 * reach:
        raise _endless(name, outlined)
    return Region(name, pieces)


def _parts(name: str, sketch: Sketch, filled: float) -> list[np.ndarray]:
    try:
        band = filled * sketch.camera.width
        return [part for stroke in sketch.outlines for part in convex_parts(stroke.points, band)]
    except ValueError as error:
        raise SketchError(f"the outline of the {name} on view {sketch.view!r} {error}") from None


def _cone(camera: Camera, polygon) -> np.ndarray:
    """Half-spaces (C, 4): rows (n, d) with n^T x + d <= 0 for x seen inside the convex polygon (C, 2) [px]."""
    p = np.column_stack([polygon, np.ones(len(polygon))])
    planes = -np.cross(p, np.roll(p, -1, axis=0)) @ camera.projection
    return planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)


def _meeting(cones, bounds) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each choice of one cone per view that meet: their half-spaces with the bounds, and a point well inside."""
    met = [(bounds, None)]
    for view in cones:
        joint = [np.vstack([halfspaces, cone]) for halfspaces, _ in met for cone in view]
        met = [(h, inside) for h in joint if (inside := _deepest(h)) is not None]
    return met


def _deepest(halfspaces) -> np.ndarray | None:
    """Centre (3,) of the largest ball in the half-spaces; None where there is none of radius THINNEST."""
    rows = np.column_stack([halfspaces[:, :3], np.ones(len(halfspaces))])
    *centre, radius = linprog([0, 0, 0, -1], rows, -halfspaces[:, 3], bounds=(None, None)).x  # negative: how far apart
    return np.array(centre) if radius > THINNEST else None


def _piece(halfspaces, inside) -> tuple[np.ndarray, np.ndarray]:
    polytope = ConvexHull(HalfspaceIntersection(halfspaces, inside).intersections)
    number = np.full(len(polytope.points), -1)
    number[polytope.vertices] = np.arange(len(polytope.vertices))
    vertices, faces = polytope.points[polytope.vertices], number[polytope.simplices]
    inward = (_normals(vertices, faces) * polytope.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward, ::-1]
    return vertices, faces


def _normals(vertices, faces) -> np.ndarray:
    """(F, 3), as long as twice the faces' areas [m^2]."""
    a, b, c = vertices[faces].swapaxes(0, 1)
    return np.cross(b - a, c - a)


def _sharp(vertices, faces) -> np.ndarray:
    """(E, 2) vertices of the edges at which two faces meet at an angle."""
    normals = _normals(vertices, faces)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    owners: dict[tuple, list[int]] = {}
    for face, (a, b, c) in enumerate(np.sort(faces, axis=1).tolist()):
        for edge in ((a, b), (b, c), (a, c)):
            owners.setdefault(edge, []).append(face)
    sharp = [edge for edge, (f, g) in owners.items() if normals[f] @ normals[g] < SMOOTH]
    return np.array(sharp, dtype=int).reshape(-1, 2)


def _apart(name: str, outlined, cones, bounds) -> SketchError:
    pairs = [(a, b) for a, b in combinations(range(len(cones)), 2) if not _meeting((cones[a], cones[b]), bounds)]
    views = " and ".join(repr(outlined[k].view) for k in (pairs[0] if pairs else range(len(cones))))
    return SketchError(f"the outlines of the {name} on views {views} do not meet anywhere in space: outline the same "
                       "region on each view, with the same number (demonstration) where there are several regions")


def _endless(name: str, outlined) -> SketchError:
    views = " and ".join(repr(sketch.view) for sketch in outlined)
    return SketchError(f"the {name} has no end: views {views} look from the same side; outline it from another side")
