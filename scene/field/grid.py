"""A sparse pyramid of voxel grids over contracted space.

Notation
    c                   a place in contracted space, the cube [-2, 2]^3 (`scene.field.volume.contract`)
    level l             N_l cells along each axis, hence N_l + 1 voxels (the cells' corners)
    brick               4^3 neighbouring voxels, stored together: 64 rows of ``values``
    root                4^3 neighbouring bricks; ``roots`` holds, for each level and row-major, its place in ``table``
    table               64 rows for each kept root: the place of each of its bricks in ``values``
    f(c) = sum_l trilinear(level l, c)      8 channels: raw density, 3 diffuse colour, 3 features, and 0

Root 0 and brick 0 stand for what is not kept. Brick 0 is all zeros and is never trained: a level says nothing where
it keeps no brick. Two steps to a voxel keep what is read for a surface small enough for a processor's cache. The levels add
up, as in a Laplacian pyramid: the coarse ones learn the rough shape at once and the fine ones what remains.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from scene.field import kernels
from scene.field.device import lengthened
from scene.field.occupancy import blocks

BRICK = 4
CHANNELS = kernels.CHANNELS


@dataclass(frozen=True, eq=False)
class Grid:
    """sizes (L,) cells per axis; roots (sum,), table (64 * roots kept,) int32; values (64 * bricks, 8) float32, trained in place.

    values: an array, or a tensor on the device where they are trained; the rest, which says where they are, are arrays.
    """

    sizes: np.ndarray
    roots: np.ndarray
    table: np.ndarray
    values: np.ndarray | torch.Tensor

    @classmethod
    def empty(cls) -> "Grid":
        nothing = np.zeros(0, np.int32)
        return cls(np.zeros(0, np.int64), nothing, np.zeros(BRICK**3, np.int32), np.zeros((BRICK**3, CHANNELS), np.float32))

    @property
    def starts(self) -> np.ndarray:
        """(L,) where each level begins in ``roots``."""
        return np.concatenate([[0], np.cumsum((self.sizes // BRICK**2 + 1) ** 3)])[:-1].astype(np.int64)

    @property
    def bricks(self) -> int:
        return len(self.values) // BRICK**3

    def with_level(self, size: int, occupied: np.ndarray) -> "Grid":
        """One more level of ``size`` cells, its bricks kept where a cell of ``occupied`` (n, n, n) needs them."""
        wanted = bricks_over(occupied, size)
        kept = wanted.any(1)
        roots = np.where(kept, len(self.table) // BRICK**3 - 1 + np.cumsum(kept), 0).astype(np.int32)
        wanted = wanted[kept].ravel()
        table = np.where(wanted, self.bricks - 1 + np.cumsum(wanted), 0).astype(np.int32)
        return Grid(
            np.append(self.sizes, size).astype(np.int64), np.concatenate([self.roots, roots]),
            np.concatenate([self.table, table]), lengthened(self.values, len(self.values) + int(wanted.sum()) * BRICK**3),
        )  # fmt: skip

    def within(self, occupied: np.ndarray) -> "Grid":
        """The grid with only those bricks that cells of ``occupied`` (n, n, n) need."""
        table = np.zeros_like(self.table).reshape(-1, BRICK**3)
        for start, size in zip(self.starts, self.sizes):
            wanted = bricks_over(occupied, int(size))
            roots = self.roots[start : start + len(wanted)]
            table[roots[roots > 0]] = wanted[roots > 0]
        kept = np.flatnonzero(table.ravel() * self.table)
        table = np.zeros_like(self.table)
        table[kept] = 1 + np.arange(len(kept))
        bricks = self.values.reshape(-1, BRICK**3, CHANNELS)[np.append(0, self.table[kept])]
        return replace(self, table=table, values=np.ascontiguousarray(bricks.reshape(-1, CHANNELS)))

    def rows_near(self, level: int, places: np.ndarray) -> np.ndarray:
        """Rows of ``values`` of the kept voxels around contracted places (n, 3) on a level."""
        size, start = int(self.sizes[level]), int(self.starts[level])
        low = np.clip(np.floor((places + 2) * (size / 4)).astype(np.int64), 0, size - 1)
        voxel = (low[:, None] + np.array(list(np.ndindex(2, 2, 2)))).reshape(-1, 3)
        root = self.roots[start + np.ravel_multi_index(tuple((voxel // BRICK**2).T), (size // BRICK**2 + 1,) * 3)].astype(np.int64)
        brick = self.table[root * BRICK**3 + _inner(voxel // BRICK)].astype(np.int64)
        row = brick * BRICK**3 + _inner(voxel)
        return np.unique(row[brick > 0])

    def look_up(self, places: np.ndarray, threads: int = kernels.THREADS) -> np.ndarray:
        """f(c) (n, 8) at contracted places (n, 3)."""
        places = np.ascontiguousarray(places, np.float32)
        out = np.empty((len(places), CHANNELS), np.float32)
        kernels.in_parallel(
            kernels.look_up, len(places), threads, places, self.sizes, self.roots, self.starts, self.table, self.values, out
        )
        return out


def _inner(index):
    """Place (...,) of what has this index (..., 3) among the 4^3 of its brick, or root."""
    inside = index % BRICK
    return (inside[..., 0] * BRICK + inside[..., 1]) * BRICK + inside[..., 2]


def bricks_over(occupied: np.ndarray, size: int) -> np.ndarray:
    """(roots, 64) bool: which bricks of a level of ``size`` cells hold a corner of a cell in occupied space."""
    count, n = BRICK * (size // BRICK**2 + 1), len(occupied)
    # Along one axis, brick b holds voxels 4b..4b+3, which touch the cells 4b-1..4b+3, that is this span of ``occupied``:
    first = np.clip((BRICK * np.arange(count) - 1) * n // size, 0, n - 1)
    last = np.clip(((BRICK * np.arange(count) + BRICK) * n - 1) // size, 0, n - 1)
    wanted = occupied.astype(bool)
    for axis in range(3):
        spans = [np.take(wanted, np.minimum(first + k, last), axis=axis) for k in range((last - first).max() + 1)]
        wanted = np.logical_or.reduce(spans)
    return blocks(wanted)


def corners(table: torch.Tensor, roots: torch.Tensor, size: int, start: int, places: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The voxels around contracted places (n, 3) on one level: rows of ``values`` (n, 8), and their trilinear weights (n, 8)."""
    p = (places + 2) * (size / 4)
    low = p.floor().int().clamp_(0, size - 1)
    fraction = p - low
    voxel = torch.stack([low, low + 1], -1)  # (n, axis, 2)
    count = size // BRICK**2 + 1
    root = roots[start + _numbered(voxel >> 4, count)]
    brick = table[root * BRICK**3 + _numbered((voxel >> 2) & 3, BRICK)]
    x, y, z = torch.stack([1 - fraction, fraction], -1).unbind(1)
    weights = x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]
    return brick * BRICK**3 + _numbered(voxel & 3, BRICK), weights.flatten(1)


def _numbered(index: torch.Tensor, count: int) -> torch.Tensor:
    """Row-major numbers (n, 8) of the corners with these indices (n, axis, lower or higher), ``count`` to an axis."""
    x, y, z = index.unbind(1)
    return ((x * count**2)[:, :, None, None] + (y * count)[:, None, :, None] + z[:, None, None, :]).flatten(1)


def interpolate(values: torch.Tensor, table: torch.Tensor, roots: torch.Tensor, sizes, starts, places: torch.Tensor) -> torch.Tensor:
    """f(c) (n, 8) at contracted places (n, 3): the kernels' twin, differentiable in ``values``, on any device."""
    total = values.new_zeros(len(places), values.shape[-1])
    for size, start in zip(map(int, sizes), map(int, starts)):
        rows, weights = corners(table, roots, size, start, places)
        total = total + (weights.to(values.dtype)[..., None] * values[rows]).sum(1)
    return total
