"""How far apart two convex pieces are, for certain: a check of FCL's answers, and what replaces wrong ones.

Notation
    n           unit vector from one piece B to the other A
    h_A(n)      extent of A along n: the largest n . a
    gap(n)      -h_A(-n) - h_B(n): the planes across n that hold the pieces leave this much room between them

gap(n) <= distance for every n, with equality for the right one. FCL's own iteration stops early about once in some
thousand queries (15 mm too far between a ball and a mesh, 1 mm between cylinders) and never says so; then gap(n) of its
nearest points stays behind its distance. Wolfe's algorithm (1976), on the differences a - b, goes on until both agree.
"""

import fcl
import numpy as np
from numba import njit

from robot.shapes import BOX, CYLINDER, SPHERE

MESH = 4
TRUSTED, AGREED = 1e-4, 1e-5  # m, by which gap and distance may differ: FCL's, and ours


class Solid:
    """A shapes.Piece as the compiled functions take it."""

    def __init__(self, piece):
        self.kind = MESH if isinstance(piece.geometry, fcl.Convex) else piece.bound
        self.size = np.append(piece.size, np.zeros(3 - len(piece.size)))
        self.vertices = np.ascontiguousarray(piece.vertices, dtype=float)

    def arrays(self, pose) -> tuple:
        """What ``support`` takes, with the piece's pose (4, 4)."""
        return self.kind, self.size, self.vertices, pose


@njit(cache=True)
def support(kind, size, vertices, pose, n):
    """The farthest point (3,) of a piece along n (3,)."""
    local, point, out = np.empty(3), np.zeros(3), np.empty(3)
    for i in range(3):
        local[i] = pose[0, i] * n[0] + pose[1, i] * n[1] + pose[2, i] * n[2]
    if kind == MESH:
        best, chosen = -np.inf, 0
        for v in range(len(vertices)):
            along = vertices[v, 0] * local[0] + vertices[v, 1] * local[1] + vertices[v, 2] * local[2]
            if along > best:
                best, chosen = along, v
        for i in range(3):
            point[i] = vertices[chosen, i]
    elif kind == BOX:
        for i in range(3):
            point[i] = size[i] if local[i] >= 0 else -size[i]
    else:
        around = np.sqrt(local[0] ** 2 + local[1] ** 2)
        length = around if kind == CYLINDER else np.sqrt(around**2 + local[2] ** 2)
        if length > 0:
            for i in range(2 if kind == CYLINDER else 3):
                point[i] = size[0] * local[i] / length
        if kind != SPHERE:
            point[2] += size[1] if local[2] >= 0 else -size[1]
    for i in range(3):
        out[i] = pose[i, 0] * point[0] + pose[i, 1] * point[1] + pose[i, 2] * point[2] + pose[i, 3]
    return out


@njit(cache=True)
def gap(kind_a, size_a, vertices_a, pose_a, kind_b, size_b, vertices_b, pose_b, x, y, z):
    """Room [m] between the pieces along (x, y, z)."""
    length = max(np.sqrt(x * x + y * y + z * z), 1e-12)
    n = np.array([x / length, y / length, z / length])
    a = support(kind_a, size_a, vertices_a, pose_a, -n)
    b = support(kind_b, size_b, vertices_b, pose_b, n)
    return (a[0] - b[0]) * n[0] + (a[1] - b[1]) * n[1] + (a[2] - b[2]) * n[2]


def distance(a, b, tries=200) -> float:
    """Distance [m] of two pieces, given by ``Solid.arrays``, to within AGREED; 0 where they meet."""
    difference = lambda x: support(*a, -x) - support(*b, x)
    x = difference(np.array([1.0, 0, 0]))
    corners, weights = x[None], np.ones(1)
    for _ in range(tries):
        length = np.linalg.norm(x)
        if length < AGREED:
            return 0.0
        p = difference(x)
        if length - p @ x / length < AGREED or (np.abs(corners - p).max(axis=1) < 1e-12).any():
            break
        corners, weights = _nearest(np.vstack([corners, p]), np.append(weights, 0.0))
        x = weights @ corners
    return float(np.linalg.norm(x))


def _nearest(corners, weights):
    """The corners (K, 3) and weights whose combination is nearest to the origin: Wolfe's minor cycle."""
    while True:
        K = len(corners)
        system = np.block([[corners @ corners.T, np.ones((K, 1))], [np.ones((1, K)), np.zeros((1, 1))]])
        wanted = np.linalg.lstsq(system, np.append(np.zeros(K), 1.0), rcond=None)[0][:K]
        if (wanted > 1e-12).all():
            return corners, wanted
        falling = wanted < weights
        share = min(1.0, (weights[falling] / (weights - wanted)[falling])[wanted[falling] <= 1e-12].min(initial=1.0))
        weights = weights + share * (wanted - weights)
        kept = weights > 1e-12
        if kept.all() or not kept.any():
            return corners, np.maximum(weights, 0) / np.maximum(weights, 0).sum()
        corners, weights = corners[kept], weights[kept] / weights[kept].sum()
