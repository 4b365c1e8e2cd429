"""Which part of space a field is made of: the box of interest, what the photographs see, what is occupied.

An occupancy grid is (n, n, n) bool over contracted space, the cube [-2, 2]^3 (`scene.field.volume.contract`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scene.field import kernels
from scene.field.cells import chebyshev, dilate

MARGIN = 1.2  # width of the box of interest over that of the pictures there
FARTHEST = 32  # distances to occupied blocks of cells are counted up to this many


def box_of_interest(views, points=None, bounds=None) -> tuple[np.ndarray, float]:
    """Centre (3,) and half width of the cube that gets the grid's full resolution [m].

    bounds: (2, 3) lowest and highest corner. Without it the cube lies around what the cameras have in common: the
    points (N, 3) that most of them see, or else the place where their optical axes meet; it is as wide as their pictures there.
    """
    if bounds is not None:
        low, high = np.asarray(bounds, dtype=float)
        if not (np.isfinite([low, high]).all() and (high >= low).all() and (high - low).max() > 0):
            raise ValueError(f"bounds must be a lower and a higher corner, not {low} and {high}")
        return (low + high) / 2, float((high - low).max() / 2)
    cameras = [view.camera for view in views]
    middle = _common_point(cameras, points) if points is not None and len(points) >= 10 else _focus(cameras)
    widths = [abs(camera.depth(middle)) * camera.width / camera.K[0, 0] / 2 for camera in cameras]
    return middle, MARGIN * float(max(np.median(widths), 1e-6))


def _common_point(cameras, points) -> np.ndarray:
    points = np.asarray(points, dtype=float)
    seen_by = np.sum([camera.contains(camera.project(points)) for camera in cameras], axis=0)
    return np.median(points[seen_by >= 0.8 * seen_by.max()], axis=0)


def _focus(cameras) -> np.ndarray:
    """The point nearest to all optical axes (least squares)."""
    centres = np.array([camera.centre for camera in cameras])
    axes = np.array([camera.forward for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weak = 1e-6 * np.eye(3)  # parallel axes: the point nearest to the cameras
    return np.linalg.solve(across.sum(0) + weak, (across @ centres[:, :, None]).sum(0)[:, 0] + weak @ centres.mean(0))


def nearest(views, points=None) -> float:
    """A distance [m] from all cameras within which nothing is, by the points (N, 3) that they may see; 0 without points."""
    if points is None or len(points) < 10:
        return 0.0
    depths = []
    for camera in (view.camera for view in views):
        inside = camera.contains(camera.project(points))
        depths.append(np.percentile(camera.depth(points[inside]), 1) if inside.any() else 0.0)
    return 0.6 * float(min(depths))


def contract(x: np.ndarray) -> np.ndarray:
    """`scene.field.volume.contract` in numpy: (..., 3) -> (..., 3)."""
    r = np.maximum(np.abs(x).max(-1, keepdims=True), 1.0)
    return x * (2 * r - 1) / r**2


def uncontract(c: np.ndarray) -> np.ndarray:
    """The inverse of `contract`; the outermost places come back from a thousand times the box."""
    r = np.abs(c).max(-1, keepdims=True)
    return np.where(r <= 1, c, c / np.maximum(r * np.maximum(2 - r, 1e-3), 1e-9))


def cell_centres(n: int) -> np.ndarray:
    """(n^3, 3) contracted places of the cells' centres, row-major."""
    axis = (np.arange(n) + 0.5) * 4 / n - 2
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def seen(views, centre, half: float, n: int) -> np.ndarray:
    """Cells that 8 % of the pictures show, two or more, and their neighbours."""
    world = uncontract(cell_centres(n)) * half + centre
    homogeneous = np.concatenate([world, np.ones((len(world), 1))], 1).astype(np.float32)
    count = np.zeros(len(world), np.int32)
    for view in views:
        x, y, z = view.camera.projection.astype(np.float32) @ homogeneous.T
        count += (z > 0) & (x >= 0) & (x <= z * view.camera.width) & (y >= 0) & (y <= z * view.camera.height)
    least = max(2, round(0.08 * len(views)))
    return dilated((count >= least).reshape(n, n, n))


def empty_by_sight(views, points, centre, half: float, n: int, least: int = 3) -> np.ndarray:
    """(n, n, n) bool: cells that at least ``least`` cameras look through on their way to a point they see.

    Which camera sees which point is not known; it is taken to be seen where nothing nearer lies in its neighbourhood of
    the picture and the picture has the colour that most cameras see there. Cells at and beside points are never empty.
    """
    points = np.asarray(points, dtype=float)
    pixels = np.stack([view.camera.project(points) for view in views])
    inside = np.stack([view.camera.contains(p) for view, p in zip(views, pixels)])
    colours = np.full((*inside.shape, 3), np.nan, np.float32)
    for k, view in enumerate(views):
        x, y = pixels[k, inside[k]].T.astype(int)
        colours[k, inside[k]] = view.image[np.minimum(y, view.camera.height - 1), np.minimum(x, view.camera.width - 1)]
    likely = inside.any(0)
    colour = np.full((len(points), 3), np.nan, np.float32)
    colour[likely] = np.nanmedian(colours[:, likely], axis=0)
    cameras_through, last = np.zeros(n**3, np.uint8), np.full(n**3, 255, np.uint8)
    for k, view in enumerate(views):
        agrees = inside[k] & (np.abs(colours[k] - colour).max(-1) < 40)
        seen_points = points[agrees][_nearest(pixels[k, agrees], view.camera.depth(points[agrees]))]
        _look_through(k % 255, view.camera.centre, seen_points, centre, half, n, least, cameras_through, last)
    m = n // 4
    through = cells_of_blocks(cameras_through >= least, m)
    return through & ~dilated(around(contract((points - centre) / half), n))


def _nearest(pixels, depth, window: int = 24, tolerance: float = 1.08) -> np.ndarray:
    """(m,) bool: points that no point within the same ``window`` [px] of the picture lies clearly in front of."""
    keys = np.unique(pixels.astype(int) // window, axis=0, return_inverse=True)[1].ravel()
    front = np.full(len(pixels), np.inf)
    np.minimum.at(front, keys, depth)
    return depth < tolerance * front[keys]


def _look_through(k, origin, points, centre, half, n, least, cameras_through, last) -> None:
    """Add camera k at ``origin`` to the count of each cell that lies on its way to a point, short of the point's surroundings."""
    away = points - origin
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    lengths = distance[:, 0] - np.maximum(0.01 * distance[:, 0], 4 / n * half)
    origins = np.repeat(((origin - centre) / half)[None], len(points), 0).astype(np.float32)
    directions = (away / distance).astype(np.float32)
    kernels.pass_through(origins, directions, (lengths / half).astype(np.float32), n, np.uint8(k), np.uint8(least), cameras_through, last)


def around(places: np.ndarray, n: int) -> np.ndarray:
    """Cells that hold one of the contracted places (m, 3)."""
    occupied = np.zeros((n, n, n), bool)
    occupied[tuple(np.clip(((places + 2) * (n / 4)).astype(int), 0, n - 1).T)] = True
    return occupied


def dilated(occupied: np.ndarray) -> np.ndarray:
    """Occupied cells (n, n, n) and all beside them (L-inf); n is a multiple of 4."""
    return cells(dilate(bits(occupied), len(occupied) // 4))


def resampled(occupied: np.ndarray, n: int) -> np.ndarray:
    """The same space in cells of another size, (n, n, n); n is a multiple of the present size."""
    index = (np.arange(n) * len(occupied)) // n
    return occupied[np.ix_(index, index, index)]


def blocks(cells: np.ndarray) -> np.ndarray:
    """(n, n, n) -> (n/4 ^3, 64): the cells in blocks of 4^3, blocks and cells row-major."""
    m = len(cells) // 4
    return np.ascontiguousarray(cells.reshape(m, 4, m, 4, m, 4).transpose(0, 2, 4, 1, 3, 5)).reshape(-1, 64)


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Which cells are occupied, as rays read it: for each block of 4^3 cells, row-major,

    mask (m^3,) uint64: a bit for each cell; distance (m^3,) uint8: blocks to the nearest block that is not empty.
    """

    mask: np.ndarray
    distance: np.ndarray

    @classmethod
    def of(cls, occupied: np.ndarray) -> "Occupancy":
        """From cells (n, n, n) bool; n is a multiple of 4."""
        return cls.from_mask(bits(occupied))

    @classmethod
    def from_mask(cls, mask: np.ndarray) -> "Occupancy":
        m = round(len(mask) ** (1 / 3))
        return cls(mask, chebyshev((mask > 0).astype(np.uint8).reshape(m, m, m), np.uint8(FARTHEST)).ravel())

    @cached_property
    def reach(self) -> float:
        """Half width of the smallest cube about the origin, not contracted, that holds all occupied blocks; 0 without any."""
        m = round(len(self.mask) ** (1 / 3))
        index = np.stack(np.unravel_index(np.flatnonzero(self.mask), (m, m, m)))
        widest = float(np.maximum((index + 1) * 4 / m - 2, 2 - index * 4 / m).max(initial=0))
        return widest if widest <= 1 else 1 / max(2 - widest, 1e-6)

    @property
    def size(self) -> int:
        """Cells an axis."""
        return 4 * round(len(self.mask) ** (1 / 3))


def cells_of_blocks(flags: np.ndarray, m: int) -> np.ndarray:
    """The inverse of `blocks`: (64 m^3) flags of cells, block by block -> (4m, 4m, 4m)."""
    return np.ascontiguousarray(flags.reshape(m, m, m, 4, 4, 4).transpose(0, 3, 1, 4, 2, 5)).reshape(4 * m, 4 * m, 4 * m)


def cells(mask: np.ndarray) -> np.ndarray:
    """The cells (n, n, n) bool that a mask (m^3,) uint64 has a bit for."""
    m = round(len(mask) ** (1 / 3))
    return cells_of_blocks(np.unpackbits(mask.view(np.uint8), bitorder="little").view(bool), m)


def bits(occupied: np.ndarray) -> np.ndarray:
    """The inverse of `cells`."""
    return np.packbits(blocks(occupied), axis=1, bitorder="little").view(np.uint64).ravel()


def marked(mask: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The mask with the cells that hold one of the contracted places (k, 3)."""
    m = round(len(mask) ** (1 / 3))
    x, y, z = np.clip(((places + 2) * m).astype(np.int64), 0, 4 * m - 1).T
    mask, bit = mask.copy(), (x & 3) << 4 | (y & 3) << 2 | (z & 3)
    np.bitwise_or.at(mask, ((x >> 2) * m + (y >> 2)) * m + (z >> 2), np.uint64(1) << bit.astype(np.uint64))
    return mask
