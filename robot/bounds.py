"""Bounds from below on clearances, compiled: balls that cover the arm, against primitives and against each other."""

import numpy as np
from numba import njit

from robot.shapes import BOX, CAPSULE, CYLINDER


@njit(cache=True)
def _outside(kind, size, x, y, z):
    """Signed distance [m] of a point to a primitive at the origin: exact outside, no larger than the truth inside."""
    if kind == BOX:
        a, b, c = abs(x) - size[0], abs(y) - size[1], abs(z) - size[2]
    elif kind == CYLINDER:
        a, b, c = np.sqrt(x * x + y * y) - size[0], -np.inf, abs(z) - size[1]
    elif kind == CAPSULE:
        along = max(abs(z) - size[1], 0.0)
        return np.sqrt(x * x + y * y + along * along) - size[0]
    else:
        return np.sqrt(x * x + y * y + z * z) - size[0]
    out = np.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2 + max(c, 0.0) ** 2)
    return out + min(max(a, b, c), 0.0)


@njit(cache=True)
def _place(poses, balls, first, links, out):
    for piece in range(len(links)):
        T = poses[links[piece]]
        for b in range(first[piece], first[piece + 1]):
            for i in range(3):
                out[b, i] = T[i, 0] * balls[b, 0] + T[i, 1] * balls[b, 1] + T[i, 2] * balls[b, 2] + T[i, 3]


@njit(cache=True)
def lower_bounds(poses, balls, first, links, pairs, kinds, sizes, piece_from_world):
    """Link poses (N, L, 4, 4) -> bounds from below (N, pairs) [m] by the balls (B, 4) that cover the arm."""
    out = np.full((len(poses), len(pairs)), np.inf)
    centres = np.empty((len(balls), 3))
    count = len(links)
    for n in range(len(poses)):
        _place(poses[n], balls, first, links, centres)
        for p in range(len(pairs)):
            a, b = pairs[p]
            for i in range(first[a], first[a + 1]):
                x, y, z = centres[i]
                if b >= count:
                    M = piece_from_world[b - count]
                    d = _outside(
                        kinds[b - count],
                        sizes[b - count],
                        M[0, 0] * x + M[0, 1] * y + M[0, 2] * z + M[0, 3],
                        M[1, 0] * x + M[1, 1] * y + M[1, 2] * z + M[1, 3],
                        M[2, 0] * x + M[2, 1] * y + M[2, 2] * z + M[2, 3],
                    )
                    out[n, p] = min(out[n, p], d - balls[i, 3])
                else:
                    for j in range(first[b], first[b + 1]):
                        r = np.sqrt((x - centres[j, 0]) ** 2 + (y - centres[j, 1]) ** 2 + (z - centres[j, 2]) ** 2)
                        out[n, p] = min(out[n, p], r - balls[i, 3] - balls[j, 3])
    return out
