"""The field's inner loops in torch, for a GPU: what `scene.field.kernels` does on a CPU, with the same samples.

Notation as in `scene.field.volume`. Rays are marched together, a burst of steps at a time (`scene.field.walk`), and those
that have become opaque stop. What they found is composited afterwards, which torch can differentiate.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from scene.field import volume, walk
from scene.field.grid import CHANNELS, interpolate
from scene.field.kernels import WEIGHT
from scene.field.rays import Marched, Rays

CHUNK = 2**16
"""Rays marched at once, at most."""
GATHER = 2**16
"""Samples whose voxels are read or written at once, at most: eight of eight numbers each."""


@dataclass(eq=False)
class Samples:
    """What n rays found, m samples ray by ray. count (n,): of each ray; of each sample ray, slot (m,): its ray and its place
    there; t (m,): distance; place (m, 3): contracted; length (m,): of the stretch it stands for [t]; feature (m, 8): channels."""

    count: torch.Tensor
    ray: torch.Tensor
    slot: torch.Tensor
    t: torch.Tensor
    place: torch.Tensor
    length: torch.Tensor
    feature: torch.Tensor

    @classmethod
    def sorted(cls, count: torch.Tensor, bursts: list[tuple]) -> "Samples":
        """From bursts of ray, slot, t, place, length and feature, in which a ray comes in several pieces."""
        ray, slot, *rest = (torch.cat(parts) for parts in zip(*bursts))
        order = torch.empty_like(ray)
        order[(count.cumsum(0) - count)[ray] + slot] = torch.arange(len(ray), device=ray.device)
        return cls(count, ray[order], slot[order], *(part[order] for part in rest))

    @cached_property
    def most(self) -> int:
        """Samples of the ray that has most, or 1."""
        return int(self.slot.max()) + 1 if len(self.slot) else 1

    def padded(self, numbers: torch.Tensor) -> torch.Tensor:
        """Numbers of the samples (m,) -> (n, most), 0 where a ray has fewer."""
        return numbers.new_zeros(len(self.count), self.most).index_put((self.ray, self.slot), numbers)


@dataclass(eq=False)
class Composed:
    """channels (n, 6): composited colour and features; through (n,): transmittance left; alpha, weights (n, most)."""

    channels: torch.Tensor
    through: torch.Tensor
    alpha: torch.Tensor
    weights: torch.Tensor


class Twin:
    """Marches and shades a field whose voxels and network are tensors on ``device``."""

    def __init__(self, device: torch.device):
        self.device = device
        self.advance = walk.fused(device)
        self._held = {}

    def tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.require(array, requirements="CW"), device=self.device)  # torch warns of what it cannot write to

    def held(self, name: str, array: np.ndarray) -> torch.Tensor:
        """The tensor of an array that is replaced and never written to: it goes to the device once."""
        if self._held.get(name, (None,))[0] is not array:
            bits = array.view(np.int64) if array.dtype == np.uint64 else array
            self._held[name] = array, self.tensor(bits)
        return self._held[name][1]

    def index(self, field) -> tuple[torch.Tensor, torch.Tensor]:
        """The table and the roots of a field's grid."""
        return self.held("table", field.grid.table), self.held("roots", field.grid.roots)

    def cells(self, field) -> tuple[torch.Tensor, torch.Tensor]:
        """The distances and the masks of a field's occupancy."""
        return self.held("distance", field.occupied.distance), self.held("mask", field.occupied.mask)

    @torch.no_grad()
    def gather(self, field, rays: Rays, far, jitter, stop: float) -> Samples:
        """The samples of rays until they end at far (n,) or let through no more light than ``stop``."""
        o, d, t, far, jitter = map(self.tensor, (rays.origins, rays.directions, rays.near, far, jitter))
        t = t + jitter * field.step / volume.along(o, d, t)[1].norm(dim=-1)
        space = t.new_full((), field.step), field.occupied.size, *self.cells(field)
        through, count = torch.ones_like(t), torch.zeros(len(t), dtype=torch.long, device=self.device)
        live, bursts = torch.arange(len(t), device=self.device), []
        while len(live) or not bursts:
            ts, on, speed, after = walk.burst(self.advance, o[live], d[live], t[live], far[live], *space)
            on, kept, place, feature = self._reached(field, o[live], d[live], through[live], ts, on, stop)
            row, k = on.nonzero(as_tuple=True)
            slot = count[live, None] + on.cumsum(1) - 1
            bursts.append((live[row], slot[row, k], ts[row, k], place, field.step / speed[row, k], feature))
            through[live] *= torch.where(on, kept, 1).prod(1)
            count[live] += on.sum(1)
            t[live] = after
            live = live[(after < far[live]) & (through[live] > stop)]
        return Samples.sorted(count, bursts)

    def _reached(self, field, o, d, through, ts, on, stop: float):
        """Which samples (n, k) of a burst light reaches, what share of it each lets through, and of those their places and channels."""
        row, k = on.nonzero(as_tuple=True)
        place = volume.contract(torch.addcmul(o[row], d[row], ts[row, k, None]))
        feature = self._look_up(field, place)
        kept = 1 - torch.zeros_like(ts).index_put((row, k), _alpha(field, feature))
        light = torch.cat([through[:, None], kept], 1).cumprod(1)  # before each, and after the last
        lit = on & (light[:, :-1] > stop)
        return lit, kept, place[lit[row, k]], feature[lit[row, k]]

    def _look_up(self, field, place: torch.Tensor) -> torch.Tensor:
        grid, index = field.grid, self.index(field)
        parts = [interpolate(grid.values, *index, grid.sizes, grid.starts, part) for part in place.split(GATHER)]
        return torch.cat(parts) if parts else grid.values.new_zeros(0, CHANNELS)

    def composite(self, field, samples: Samples) -> Composed:
        """What the samples give along each ray, differentiable in their channels."""
        alpha = samples.padded(_alpha(field, samples.feature))
        weights, through = volume.composite(alpha)
        weighted = weights[samples.ray, samples.slot, None] * samples.feature[:, 1:WEIGHT]
        channels = weighted.new_zeros(len(through), WEIGHT - 1).index_add(0, samples.ray, weighted)
        return Composed(channels, through, alpha, weights)

    def note(self, field, samples: Samples, composed: Composed, seen, surface, visible: float) -> None:
        """Set the bits of cells that are seen, and of those that hold a surface, see `kernels.march`."""
        weights, light = composed.weights.detach(), (1 - composed.alpha.detach()).cumprod(1)
        least = visible * torch.maximum(weights.amax(1), light[:, -1])
        before = torch.cat([torch.ones_like(light[:, :1]), light[:, :-1]], 1)
        cell = walk.cell(samples.place, field.occupied.size)
        for bits, noted in ((seen, weights > least[:, None]), (surface, (before > 0.5) & (light <= 0.5))):
            numbers = cell[noted[samples.ray, samples.slot]].cpu().numpy()
            np.bitwise_or.at(bits, numbers >> 6, np.uint64(1) << (numbers & 63).astype(np.uint64))

    @torch.no_grad()
    def march(self, field, rays: Rays, far, jitter, stop: float, keep: bool, seen, surface, visible: float) -> Marched:
        """`Field.march`; the cells are noted if samples are to be kept."""
        parts = []
        for begin in range(0, max(len(far), 1), CHUNK):
            part = slice(begin, begin + CHUNK)
            some = Rays(rays.origins[part], rays.directions[part], rays.near[part])
            samples = self.gather(field, some, far[part], jitter[part], stop)
            composed = self.composite(field, samples)
            if keep:
                self.note(field, samples, composed, seen, surface, visible)
            parts.append((*self._found(samples, composed, some, far[part]), *(self._kept(samples, composed) if keep else ())))
        channels, through, distance, *samples = (torch.cat(piece).cpu().numpy() for piece in zip(*parts))
        return Marched(channels, through, distance, (np.cumsum(samples[0]) - samples[0], *samples) if keep else ())

    def _found(self, samples: Samples, composed: Composed, rays: Rays, far) -> tuple[torch.Tensor, ...]:
        t, half = samples.padded(samples.t), samples.padded(samples.length / 2)
        distance = volume.median_depth(composed.alpha, t - half, t + half)
        distance = torch.clamp(distance, self.tensor(rays.near), self.tensor(far))
        return torch.nn.functional.pad(composed.channels, (1, CHANNELS - WEIGHT)), composed.through, distance

    def _kept(self, samples: Samples, composed: Composed) -> tuple[torch.Tensor, ...]:
        return samples.count, samples.t, composed.alpha[samples.ray, samples.slot], samples.feature

    @torch.no_grad()
    def shade(self, field, marched: Marched, rays: Rays, behind) -> np.ndarray:
        """`Field.shade`."""
        channels, through, directions, behind = map(self.tensor, (marched.channels[:, 1:WEIGHT], marched.through, rays.directions, behind))
        return volume.shade(channels, through, directions, behind, *field.shading.parameters).cpu().numpy()


def _alpha(field, feature: torch.Tensor) -> torch.Tensor:
    sigma = field.scale * torch.nn.functional.softplus(feature[:, 0] + field.shift, threshold=15)
    return volume.opacity(sigma, field.step)
