"""A rival for `tests/benchmarks/field.py`: a hash grid as it is written in stock torch (Mueller et al. 2022; 8 levels of 4 features,
networks 64 wide, an occupancy grid), learned for so many seconds on the same rays."""

import time

import numpy as np
import torch
from torch import nn

from scene.exposure import backdrop
from scene.field import UNSEEN, occupancy
from scene.field.volume import composite, contract, harmonics
from scene.photographs import Photographs

LEVELS, FEATURES, ENTRIES, COARSEST, FINEST = 8, 4, 2**17, 16, 1024
CELLS, SAMPLES, BATCH, DECAY = 64, 96, 1024, 0.95
PRIMES = torch.tensor([1, 2654435761, 805459861])


class HashGrid(nn.Module):
    """Places in [-2, 2]^3 (n, 3) and directions (n, 3) -> density (n,) and colour (n, 3)."""

    def __init__(self):
        super().__init__()
        self.sizes = np.geomspace(COARSEST, FINEST, LEVELS).round().astype(int)
        self.tables = nn.ParameterList(nn.Parameter(1e-4 * torch.randn(ENTRIES, FEATURES)) for _ in self.sizes)
        self.inner = nn.Sequential(nn.Linear(LEVELS * FEATURES, 64), nn.ReLU(), nn.Linear(64, 16))
        self.outer = nn.Sequential(nn.Linear(16 + 9, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 3))

    def _level(self, table, size: int, places):
        p = (places + 2) * (size / 4)
        low = p.floor()
        corner = torch.tensor(list(np.ndindex(2, 2, 2)))
        voxel = (low.long()[:, None] + corner) * PRIMES
        fraction = torch.where(corner.bool(), (p - low)[:, None], 1 - (p - low)[:, None]).prod(-1)
        index = (voxel[..., 0] ^ voxel[..., 1] ^ voxel[..., 2]) % ENTRIES
        return nn.functional.embedding_bag(index, table, per_sample_weights=fraction, mode="sum")

    def density(self, places):
        hidden = self.inner(torch.cat([self._level(t, int(n), places) for t, n in zip(self.tables, self.sizes)], -1))
        return torch.exp(hidden[:, 0].clamp(max=10)), hidden

    def forward(self, places, directions):
        density, hidden = self.density(places)
        return density, torch.sigmoid(self.outer(torch.cat([hidden, harmonics(directions)], -1)))


class Rival:
    """A hash grid of a scene: `fit` learns it, `render` shows it."""

    def __init__(self, views, points, seed: int = 0):
        torch.manual_seed(seed)
        self.centre, self.half = occupancy.box_of_interest(views, points)
        self.near = occupancy.nearest(views, points) / self.half
        plain = backdrop(views)
        self.behind = torch.tensor(plain if len(plain) else UNSEEN, dtype=torch.float32)
        self.occupied = torch.tensor(occupancy.seen(views, self.centre, self.half, CELLS))
        self.mean = torch.ones(CELLS**3)
        self.model, self.views, self.rng = HashGrid(), views, np.random.default_rng(seed)

    def fit(self, seconds: float) -> int:
        """Learn for so many seconds; how many steps that were."""
        pictures = Photographs.of(self.views, self.centre, self.half, 1)
        descent = torch.optim.Adam(self.model.parameters(), lr=1e-2, eps=1e-15)
        started, steps = time.perf_counter(), 0
        while (done := (time.perf_counter() - started) / seconds) < 1:
            descent.param_groups[0]["lr"] = 1e-2 * 0.1**done
            rays, target, _ = pictures.draw(self.rng, BATCH, self.near)
            loss = ((self._colours(rays.origins, rays.directions, jitter=True) - torch.tensor(target)) ** 2).mean()
            descent.zero_grad()
            loss.backward()
            descent.step()
            steps += 1
            if steps % 100 == 0:
                self._prune()
        return steps

    @torch.no_grad()
    def _prune(self):
        places = torch.tensor(occupancy.cell_centres(CELLS), dtype=torch.float32) + (torch.rand(CELLS**3, 3) - 0.5) * 4 / CELLS
        known = self.occupied.flatten()
        density = torch.zeros(CELLS**3)
        density[known] = torch.cat([self.model.density(part)[0] for part in places[known].split(2**16)])
        self.mean = torch.maximum(DECAY * self.mean, density)
        self.occupied = (known & (self.mean * 4 / CELLS > 0.01)).reshape(CELLS, CELLS, CELLS)

    def _colours(self, origins, directions, jitter: bool = False):
        o, d = torch.as_tensor(origins), torch.as_tensor(directions)
        n, reach = len(o), 4.0
        at = torch.rand(n, SAMPLES) if jitter else torch.full((n, SAMPLES), 0.5)
        t = self.near + (torch.arange(SAMPLES) + at) * (reach / SAMPLES)
        places = contract(o[:, None] + t[..., None] * d[:, None])
        cell = ((places + 2) * (CELLS / 4)).long().clamp(0, CELLS - 1)
        on = self.occupied[cell[..., 0], cell[..., 1], cell[..., 2]]
        density, colour = self.model(places[on], d[:, None].expand(-1, SAMPLES, -1)[on])
        alpha = torch.zeros(n, SAMPLES).masked_scatter(on, 1 - torch.exp(-density * reach / SAMPLES))
        weights, through = composite(alpha)
        shown = torch.zeros(n, SAMPLES, 3).masked_scatter(on[..., None], colour)
        return (weights[..., None] * shown).sum(1) + through[:, None] * self.behind

    @torch.no_grad()
    def render(self, camera, every: int = 1) -> np.ndarray:
        """Colours (h, w, 3) uint8 of a camera's pixels, of each ``every``-th row and column."""
        origins, directions = camera.rays(camera.pixel_centres()[::every, ::every].reshape(-1, 2))
        origins = ((origins - self.centre) / self.half).astype(np.float32)
        parts = zip(np.array_split(origins, 50), np.array_split(directions.astype(np.float32), 50))
        colours = torch.cat([self._colours(o, d) for o, d in parts]).numpy()
        size = len(range(0, camera.height, every)), len(range(0, camera.width, every)), 3
        return np.clip(colours.reshape(size) * 255 + 0.5, 0, 255).astype(np.uint8)
