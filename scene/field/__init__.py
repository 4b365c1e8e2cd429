"""The field: density and colour everywhere in a scene, and the pictures it gives.

A ray's channels are composited along the ray first (`scene.field.volume`) and shaded once: the diffuse colour is
a sum of voxels, and a small network adds what depends on the direction of view, from the composited
features (deferred shading, as in SNeRG and MERF). Light that passes everything meets ``background``.
"""

import zipfile
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scene.camera import Camera
from scene.field import kernels, network
from scene.field.device import chosen, placed
from scene.field.grid import BRICK, CHANNELS, Grid
from scene.field.occupancy import Occupancy, cells
from scene.field.rays import Marched, Rays
from scene.field.twin import Twin
from scene.files import replacing

VERSION = 4
QUANTA = np.float32([1 / 16] + [1 / 128] * 3 + [1 / 256] * 4)  # to which a file rounds raw density, colour, features
FAR = 1e4
STOP = 1e-3
STOP_TRAINING = 1e-2
UNSEEN = (0.5, 0.5, 0.5)  # shown where a scene without a background has nothing


@dataclass(eq=False)
class Shading:
    """The network: composited channels and direction of view -> colour, with what lies behind everything.

    background (3,): the plain colour behind everything, (0,) if there is none; inner (15, H), outer (H, 3): weights, see
    `network.shade`.
    """

    background: np.ndarray
    inner: np.ndarray
    outer: np.ndarray

    @classmethod
    def initial(cls, rng: np.random.Generator, background: np.ndarray, hidden: int = 32) -> "Shading":
        """No dependence on the direction of view."""
        inner = rng.normal(0, np.sqrt(2 / 15), (15, hidden)).astype(np.float32)
        return cls(background, inner, np.zeros((hidden, 3), np.float32))

    @property
    def parameters(self) -> tuple[np.ndarray, np.ndarray]:
        """What is trained."""
        return self.inner, self.outer


@dataclass(eq=False)
class Field:
    """A trained scene.

    centre (3,) and half: the box of interest in the world [m]; grid and shading: what was learnt; occupied: where
    rays look for it; step: sample spacing in contracted space; scale, shift: density
    is scale * softplus(raw + shift); near: distance from a camera at which its rays begin, in units of ``half``.
    twin: marches in torch, if the voxels and the network are tensors on its device (`on`); else the kernels march.
    """

    centre: np.ndarray
    half: float
    grid: Grid
    shading: Shading
    occupied: Occupancy
    step: float
    scale: float
    shift: float
    near: float
    twin: Twin | None = None

    def on(self, device: str) -> "Field":
        """The field with its voxels and its network on a device, see `scene.field.device.chosen`; memory is shared where it can be."""
        where = chosen(device)
        shading = Shading(self.shading.background, *(placed(p, where) for p in self.shading.parameters))
        grid = replace(self.grid, values=placed(self.grid.values, where))
        return replace(self, grid=grid, shading=shading, twin=None if where is None else Twin(where))

    def rays(self, origins, directions) -> Rays:
        """Rays of the world (n, 3) [m] in the field's normalised coordinates."""
        origins = np.ascontiguousarray((np.asarray(origins) - self.centre) / self.half, np.float32)
        directions = np.ascontiguousarray(directions, np.float32)
        return Rays(origins, directions, np.full(len(origins), self.near, np.float32))

    def march(self, rays: Rays, far=None, jitter=None, keep: int = 0, seen=None, surface=None, visible=0.1, threads: int = kernels.THREADS) -> Marched:
        """Composite the grid along rays; ``keep`` > 0 keeps up to so many samples a ray on average, for the gradient."""
        n = len(rays.near)
        far = np.full(n, FAR, np.float32) if far is None else far
        jitter = np.full(n, 0.5, np.float32) if jitter is None else jitter
        stop = np.float32(STOP_TRAINING if keep else STOP)
        far = self.end(rays, far)
        if seen is None:
            seen = surface = np.zeros(len(self.occupied.mask) if keep else 1, np.uint64)
        if self.twin is not None:
            return self.twin.march(self, rays, far, jitter, float(stop), keep > 0, seen, surface, visible)
        capacity = max(keep, 1)
        first, count = np.empty(n, np.int64), np.empty(n, np.int64)
        cell = np.empty(n * capacity, np.int32)
        t, alpha = (np.empty(n * capacity, np.float32) for _ in range(2))
        feature = np.empty((n * capacity, CHANNELS), np.float32)
        out, through, distance = np.empty((n, CHANNELS), np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
        kernels.in_parallel(
            kernels.march, n, threads, rays.origins, rays.directions, rays.near, far, jitter,
            np.float32(self.step), np.float32(self.step * self.scale), self.occupied.size,
            self.occupied.distance, self.occupied.mask, np.float32(visible), seen, surface,
            self.grid.sizes, self.grid.roots, self.grid.starts, self.grid.table, self.grid.values, np.float32(self.shift), stop,
            min(keep, 1), capacity, first, count, cell, t, alpha, feature, out, through, distance,
        )  # fmt: skip
        return Marched(out, through, distance, (first, count, t, alpha, feature))

    def end(self, rays: Rays, far) -> np.ndarray:
        """Where rays that end at far (n,) end at the latest (n,): where they leave the cube that holds all that is occupied."""
        with np.errstate(divide="ignore", invalid="ignore"):
            leave = (np.copysign(np.float32(self.occupied.reach), rays.directions) - rays.origins) / rays.directions
        return np.fmin(far, np.fmin.reduce(leave, axis=1))

    def render(self, camera: Camera, rows: int = 64, near: float = 0.0, far: float = np.inf):
        """The picture (height, width, 3) uint8 and its depth (height, width) float32 [m] along z, nan where nothing is hit.

        near, far: only what lies between these depths [m along z] is seen; behind it is what is behind everything.
        """
        rgb = np.empty((camera.height, camera.width, 3), np.uint8)
        depth = np.empty((camera.height, camera.width), np.float32)
        pixels = camera.pixel_centres()
        for top in range(0, camera.height, rows):
            origins, directions = camera.rays(pixels[top : top + rows].reshape(-1, 2))
            rays = self.rays(origins, directions)
            beyond = 1 / (self.half * (directions @ camera.forward))  # normalised distance along a ray, for a depth [m]
            rays.near = np.maximum(rays.near, near * beyond).astype(np.float32)
            marched = self.march(rays, far=np.minimum(FAR, far * beyond).astype(np.float32))
            block = slice(top, top + rows)
            colour = self.shade(marched, rays, self.behind(len(origins))).reshape(-1, camera.width, 3)
            rgb[block] = np.clip(colour * 255 + 0.5, 0, 255).astype(np.uint8)
            along = marched.distance * self.half * (directions @ camera.forward)
            depth[block] = along.reshape(-1, camera.width)
        return rgb, depth

    def behind(self, n: int) -> np.ndarray:
        """What n rays meet (n, 3) where the scene ends."""
        background = self.shading.background if len(self.shading.background) else np.float32(UNSEEN)
        return np.broadcast_to(background, (n, 3))

    def shade(self, marched: Marched, rays: Rays, behind: np.ndarray, threads: int = kernels.THREADS) -> np.ndarray:
        """Colour (n, 3) of marched rays, before what is behind everything (n, 3)."""
        if self.twin is not None:
            return self.twin.shade(self, marched, rays, behind)
        colour = np.empty((len(rays.near), 3), np.float32)
        kernels.in_parallel(
            network.shade, len(colour), threads, marched.channels, marched.through, rays.directions,
            behind, *self.shading.parameters, colour,
        )  # fmt: skip
        return colour

    def transmittance(self, origins, points) -> np.ndarray:
        """How much light (n,) gets from each point (n, 3) to the origin (n, 3) or (3,) [m] in front of it."""
        points = np.asarray(points, dtype=float)
        away = points - origins
        distance = np.linalg.norm(away, axis=-1, keepdims=True)
        rays = self.rays(np.broadcast_to(origins, points.shape), away / np.maximum(distance, 1e-12))
        return self.march(rays, far=np.ascontiguousarray(distance[:, 0] / self.half, np.float32)).through

    def save(self, path) -> None:
        """Write the field to ``path``, atomically: what lies in occupied space, the voxels rounded to `QUANTA`."""
        home = self.on("cpu")
        grid = home.grid.within(cells(self.occupied.mask))
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(
                file,
                version=VERSION,
                centre=self.centre,
                numbers=[self.half, self.step, self.scale, self.shift, self.near],
                sizes=grid.sizes,
                roots=np.packbits(grid.roots > 0),
                kept=np.packbits(grid.table > 0),
                values=_rounded(grid.values),
                occupied=self.occupied.mask,
                background=self.shading.background,
                inner=home.shading.inner,
                outer=home.shading.outer,
            )

    @classmethod
    def load(cls, path, device: str = "auto") -> "Field":
        """Read what `save` wrote, onto a device (`on`); nothing in the file is executed.

        ValueError if it is not a whole field of this version, or the device is not there.
        """
        if Path(path).is_file() and not zipfile.is_zipfile(path):  # numpy would advise to load a pickle unsafely
            raise ValueError(f"{path} is not a field, or was cut off; train it again")
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {key: file[key] for key in file.files}
        except FileNotFoundError:
            raise
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, KeyError, NotImplementedError, RuntimeError) as error:
            raise ValueError(f"{path} is not a field, or was cut off: {error}; train it again") from None
        if "version" not in arrays or arrays["version"].shape != () or arrays["version"] != VERSION:
            raise ValueError(f"{path} is no field of version {VERSION}; train it again with this version")
        try:
            field = cls._from_arrays(**{key: value for key, value in arrays.items() if key != "version"})
        except (TypeError, ValueError, IndexError, KeyError, MemoryError) as error:
            raise ValueError(f"{path} is damaged: {error}; train it again") from None
        return field.on(device)

    @classmethod
    def _from_arrays(cls, centre, numbers, sizes, roots, kept, values, occupied, background, inner, outer) -> "Field":
        sizes = sizes.astype(np.int64).reshape(-1)
        if not (len(sizes) > 0 and ((sizes > 0) & (sizes <= 4096)).all()):
            raise ValueError(f"its grids have {sizes} cells")
        m = round(occupied.size ** (1 / 3))
        if occupied.dtype != np.uint64 or not 0 < m <= 256 or occupied.shape != (m**3,):
            raise ValueError("its occupancy has the wrong size")
        roots = _numbered(roots, int(((sizes // BRICK**2 + 1) ** 3).sum()))
        table = _numbered(kept, BRICK**3 * (1 + int(roots.max())))
        if table[: BRICK**3].any():
            raise ValueError("its tables contradict each other")
        hidden = inner.shape[-1] if inner.ndim == 2 else -1
        shapes = {
            "centre": (centre, (3,)), "numbers": (numbers, (5,)), "background": (background, (3,) if background.size else (0,)),
            "inner": (inner, (15, hidden)), "outer": (outer, (hidden, 3)),
        }  # fmt: skip
        for name, (array, shape) in shapes.items():
            if array.shape != shape or array.dtype.kind != "f" or not np.isfinite(array).all():
                raise ValueError(f"{name} must be {shape} finite numbers, not {array.dtype} {array.shape}")
        if values.dtype != np.uint8 or values.shape != (2, CHANNELS, BRICK**3 * (1 + int(table.max()))):
            raise ValueError(f"its voxels are {values.dtype} {values.shape}")
        half, step, scale, shift, near = map(float, numbers)
        if not (half > 0 and step > 0 and scale > 0 and near >= 0):
            raise ValueError("its box, step and scale must be positive")
        shading = Shading(*(np.ascontiguousarray(p, np.float32) for p in (background, inner, outer)))
        grid = Grid(sizes, roots, table, _unrounded(values))
        return cls(centre.astype(float), half, grid, shading, Occupancy.from_mask(occupied), step, scale, shift, near)


def _rounded(values: np.ndarray) -> np.ndarray:
    """Voxels (n, 8) -> (2, 8, n) uint8: the low and high bytes of their multiples of `QUANTA`.

    Most multiples are small: shifted by 128 their high bytes are 0, and alike bytes side by side compress well.
    """
    multiples = (np.clip(np.round(values / QUANTA), -32640, 32639) + 128).astype("<i2")
    return np.ascontiguousarray(multiples.T).view(np.uint8).reshape(CHANNELS, -1, 2).transpose(2, 0, 1)


def _unrounded(pairs: np.ndarray) -> np.ndarray:
    """The inverse of `_rounded`."""
    multiples = np.ascontiguousarray(pairs.transpose(2, 1, 0)).view("<i2")[..., 0]
    return (multiples.astype(np.float32) - 128) * QUANTA


def _numbered(bits: np.ndarray, count: int) -> np.ndarray:
    """``count`` packed flags -> their numbers from 1 on, 0 where a flag is not set."""
    if bits.dtype != np.uint8 or bits.shape != ((count + 7) // 8,):
        raise ValueError("its tables have the wrong size")
    flags = np.unpackbits(bits, count=count)
    return (flags * np.cumsum(flags, dtype=np.int32)).astype(np.int32)
