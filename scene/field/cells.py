"""Inner loops over the cells of an occupancy grid, for `scene.field.occupancy`."""

import numpy as np
from numba import njit

from scene.field.kernels import FAST


@njit(**FAST)
def dilate(mask, m):
    """mask (m^3,) uint64, a bit for each cell of a block -> the same with all within one cell (L-inf) of a cell that is set."""
    out, n = mask.copy(), 4 * m
    for block in range(m**3):
        for bit in range(64 if mask[block] != 0 else 0):
            if mask[block] >> np.uint64(bit) & np.uint64(1):
                x, y, z = 4 * (block // (m * m)) + (bit >> 4), 4 * (block // m % m) + (bit >> 2 & 3), 4 * (block % m) + (bit & 3)
                for i in range(max(x - 1, 0), min(x + 2, n)):
                    for j in range(max(y - 1, 0), min(y + 2, n)):
                        for k in range(max(z - 1, 0), min(z + 2, n)):
                            place = (i & 3) << 4 | (j & 3) << 2 | (k & 3)
                            out[((i >> 2) * m + (j >> 2)) * m + (k >> 2)] |= np.uint64(1) << np.uint64(place)
    return out


@njit(**FAST)
def chebyshev(occupied, limit):
    """occupied (n, n, n) uint8 -> distance [cells] of each cell to the nearest occupied one, at most ``limit``."""
    n = occupied.shape[0]
    near = np.empty((n, n, n), np.uint8)
    for x in range(n):
        for y in range(n):
            for z in range(n):
                near[x, y, z] = 0 if occupied[x, y, z] else limit
    # The distance in the L-inf norm: one pass per axis of min_k max(|k|, d(. + k)), by two-sided sweeps to ``limit``.
    for x in range(n):
        for y in range(n):
            for z in range(1, n):
                near[x, y, z] = min(near[x, y, z], near[x, y, z - 1] + 1)
            for z in range(n - 2, -1, -1):
                near[x, y, z] = min(near[x, y, z], near[x, y, z + 1] + 1)
    _pass(near.transpose(0, 2, 1))
    _pass(near.transpose(1, 2, 0))
    return near


@njit(**FAST)
def _pass(near):
    """One pass along the last axis of near (n, n, n), in place."""
    n = near.shape[2]
    line = np.empty(n, np.uint8)
    for a in range(n):
        for b in range(n):
            for k in range(n):
                line[k] = near[a, b, k]
            for k in range(n):
                near[a, b, k] = _best(line, k, n)


@njit(forceinline=True, fastmath=FAST["fastmath"], error_model="numpy")
def _best(line, at, n):
    best = line[at]
    k = 1
    while k < best:
        if at >= k:
            best = min(best, max(k, line[at - k]))
        if at + k < n:
            best = min(best, max(k, line[at + k]))
        k += 1
    return best
