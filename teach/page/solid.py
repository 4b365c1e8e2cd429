"""A scene's surface for the 3D view: thinned to what a page can draw without a graphics card, packed to what is quick to send.

    solid = thinned(vertices, faces, colours)       # at most ``most`` vertices
    solid = relief([(camera, image, depth)])        # or what depth pictures show
    packed(solid)                                   # bytes that static/raster.js unpacks

Thinning joins the vertices in each cell of a grid, at their mean place and colour: cells of one size keep the colours of flat
surfaces, which methods that keep only the shape throw away.
"""

import gzip
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

MOST = 16_000
"""Vertices that are drawn in some ten milliseconds."""
HALVINGS = 16
STEEP = 0.06
"""Share of the depth by which neighbours of one surface differ at most."""
GRID = 65_535
"""Steps of a packed coordinate."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A triangle mesh. vertices (V, 3) [m], faces (F, 3), colours (V, 3) uint8."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    colours: UInt8[np.ndarray, "V 3"]


def thinned(vertices, faces, colours, most: int = MOST) -> Solid:
    """The mesh with at most ``most`` vertices; as it is where it has no more."""
    solid = Solid(np.asarray(vertices, dtype=float), np.asarray(faces), np.asarray(colours, dtype=np.uint8))
    if len(solid.vertices) <= most:
        return solid
    fine, coarse = 0.0, float(np.ptp(solid.vertices, axis=0).max())
    for _ in range(HALVINGS):
        middle = (fine + coarse) / 2
        fine, coarse = (fine, middle) if len(np.unique(_cells(solid.vertices, middle))) <= most else (middle, coarse)
    return _joined(solid, coarse)


def _cells(vertices, edge: float) -> np.ndarray:
    """(V,) the number of the cell that each vertex lies in."""
    cells = np.floor((vertices - vertices.min(axis=0)) / edge).astype(np.int64)
    return np.ravel_multi_index(cells.T, cells.max(axis=0) + 1)


def _joined(solid: Solid, edge: float) -> Solid:
    _, of, count = np.unique(_cells(solid.vertices, edge), return_inverse=True, return_counts=True)
    mean = lambda values: np.stack([np.bincount(of, column) for column in values.T.astype(float)], axis=1) / count[:, None]
    corners = of[solid.faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(corners, axis=1), axis=0, return_index=True)
    return Solid(mean(solid.vertices), corners[np.sort(first)], np.round(mean(solid.colours)).astype(np.uint8))


def relief(seen, most: int = MOST) -> Solid:
    """What pictures see. seen: of each view its Camera, image (h, w, 3) uint8 and depth (h, w) [m], nan where there is nothing.
    Neighbours are joined where their depths differ by less than a STEEP share; the far side of an edge is open."""
    stride = max(1, int(np.ceil(np.sqrt(sum(depth.size for _, _, depth in seen) / most))))
    parts = [_relief(camera, image, depth, stride) for camera, image, depth in seen]
    begins = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = np.concatenate([part.faces + begin for part, begin in zip(parts, begins)])
    return Solid(np.concatenate([part.vertices for part in parts]), faces, np.concatenate([part.colours for part in parts]))


def _relief(camera, image, depth, stride: int) -> Solid:
    rows, columns = (np.arange(stride // 2, size, stride) for size in depth.shape)
    u, v = np.meshgrid(columns + 0.5, rows + 0.5)
    z = depth[np.ix_(rows, columns)]
    origin, direction = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2))
    far = z.reshape(-1, 1) / (direction @ camera.forward)[:, None]
    corner = np.arange(z.size).reshape(z.shape)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, c, b), (b, c, d))])
    near, most = z.ravel()[faces].min(axis=1), z.ravel()[faces].max(axis=1)
    faces = faces[most < (1 + STEEP) * near]  # nan is never below anything
    used, faces = np.unique(faces, return_inverse=True)
    return Solid((origin + far * direction)[used], faces.reshape(-1, 3), image[np.ix_(rows, columns)].reshape(-1, 3)[used])


def packed(solid: Solid) -> bytes:
    """gzip of: V, F uint32; least corner, step (3) float32 each; then uint16 coordinates (V, 3) in steps from that corner, uint16
    faces (F, 3) and uint8 colours (V, 3). Little-endian. ValueError for more vertices than 16 bits number."""
    if len(solid.vertices) > GRID:
        raise ValueError(f"{len(solid.vertices)} vertices: at most {GRID} are packed; thin the mesh first")
    low = solid.vertices.min(axis=0, initial=np.inf) if len(solid.vertices) else np.zeros(3)
    step = np.maximum(np.ptp(solid.vertices, axis=0) / GRID, 1e-9) if len(solid.vertices) else np.ones(3)
    parts = (np.array([len(solid.vertices), len(solid.faces)], "<u4"), low.astype("<f4"), step.astype("<f4"),
             np.round((solid.vertices - low) / step).astype("<u2"), solid.faces.astype("<u2"), solid.colours)  # fmt: skip
    return gzip.compress(b"".join(np.ascontiguousarray(part).tobytes() for part in parts), 6, mtime=0)
