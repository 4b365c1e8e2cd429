"""One step of gradient descent on a field; here with the kernels, in `scene.field.torch_descent` with torch."""

from dataclasses import dataclass

import numpy as np

from scene.field import Field, Rays, kernels, network
from scene.field.device import lengthened, placed
from scene.field.grid import BRICK

BETA1, BETA2 = 0.9, 0.95
EPSILON = 1e-5
LEAST = 1e-3
"""Samples with smaller gradients (of a squared colour error) and less than LIGHTEST weight are left out: RMSProp would move their voxels as far as those of a surface."""
LIGHTEST = 1e-2
KEPT = 0.98
"""Of what weighed on a voxel's colour before, this stays at each step that sees it: what the first rays say, of a shape still unknown, is forgotten."""
SLIGHT = 0.05
"""Weight of the colour that a voxel has before any ray sees it."""
MOST = 2e-4
"""At step k no colour moves by more than k times this: colours that explain each picture before the shape is known keep it from being found."""


@dataclass(frozen=True)
class Rates:
    """Learning rates: of raw density, diffuse colour (as a share of the residual, see `Descent`) and features of a voxel, and of the network."""

    density: float
    colour: float
    feature: float
    network: float

    @property
    def voxel(self) -> np.ndarray:
        return np.array([self.density] + [self.colour / 2] * 3 + [self.feature] * 3 + [0.0], np.float32)


class Descent:
    """A field's voxels and its network, moved in place, where they lie; a subclass says how a step is made.

    Given the density, pictures are linear in the diffuse colours, which take what reconstruction from projections takes: the mean
    residual of the rays that saw a voxel (SART, Andersen & Kak 1984), of all so far, so that rays that disagree settle; in small moves at
    first (MOST). Density and features follow RMSProp: a voxel is met seldom and with long breaks, so that a mean of its past gradients
    would say little. The network follows Adam.
    """

    def __init__(self, field: Field):
        self.field, self.steps, self.keep = field, 0, 128
        self.past = self._zeros()
        self.gradient = self._zeros()
        self.network = [(0 * p, 0 * p) for p in field.shading.parameters]

    def _zeros(self):
        return lengthened(self.field.grid.values[:0], len(self.field.grid.values))

    def grown(self) -> None:
        """The field's grid has got more voxels, behind the ones it had."""
        self.past = lengthened(self.past, len(self.field.grid.values))
        self.gradient = self._zeros()

    @property
    def unbiased(self) -> float:
        """sqrt(1 - beta2^k) at step k."""
        return float(np.sqrt(1 - BETA2**self.steps))

    @property
    def most(self) -> float:
        """By how much a colour may move at this step."""
        return MOST * self.steps

    def adam(self, gradients: list, rate: float) -> None:
        """One step of Adam on the network."""
        correction = self.unbiased / (1 - BETA1**self.steps)
        for p, g, (mean, square) in zip(self.field.shading.parameters, gradients, self.network):
            mean += (1 - BETA1) * (g - mean)
            square += (1 - BETA2) * (g**2 - square)
            p -= rate * correction * mean / (square**0.5 + 1e-12)

    def state(self) -> dict:
        """Everything that `restore` needs beside the field, as arrays: a descent on another device may go on with it."""
        moments = {f"network{i}{k}": placed(m, None) for i, pair in enumerate(self.network) for k, m in enumerate(pair)}
        return {"steps": self.steps, "keep": self.keep, "past": placed(self.past, None), **moments}

    def restore(self, state: dict) -> None:
        where = self.field.twin.device if self.field.twin else None
        self.steps, self.keep = int(state["steps"]), int(state["keep"])
        self.past = placed(state["past"], where)
        self.gradient = self._zeros()
        self.network = [tuple(placed(state[f"network{i}{k}"], where) for k in range(2)) for i in range(len(self.network))]


class KernelDescent(Descent):
    """On the CPU, with the kernels of `scene.field.kernels`."""

    def __init__(self, field: Field, threads: int = kernels.THREADS):
        super().__init__(field)
        self.threads = threads

    def step(self, rays: Rays, target, behind, jitter, rates: Rates, seen: np.ndarray, surface: np.ndarray, visible: float) -> float:
        """One step towards the colours ``target`` (n, 3) of rays before what is ``behind`` everything (n, 3).

        Notes the cells that are seen and those that hold a surface, see `kernels.march`. Returns the MSE.
        """
        marched = self.field.march(
            rays, jitter=jitter, keep=self.keep, seen=seen, surface=surface, visible=visible, threads=self.threads
        )
        count = int(marched.samples[1].sum())
        self.keep = int(1.3 * count / len(target)) + 16
        error = self.field.shade(marched, rays, behind, self.threads) - target
        self.steps += 1
        self._back(rays, marched, behind, error * np.float32(2), rates)
        return float(np.mean(error**2))

    def _back(self, rays: Rays, marched, behind: np.ndarray, grad_colour: np.ndarray, rates: Rates) -> None:
        field, n = self.field, len(grad_colour)
        grad_channels, grad_through = np.empty_like(marched.channels), np.empty_like(marched.through)
        grads = [np.zeros((kernels.pieces(self.threads), *p.shape), np.float32) for p in field.shading.parameters]
        kernels.in_parallel(
            network.shade_back, n, self.threads, marched.channels, marched.through, rays.directions,
            behind, *field.shading.parameters, grad_colour, grad_channels, grad_through, *grads,
        )  # fmt: skip
        touched = np.zeros(len(self.past) // BRICK**3, np.uint64)
        first, count, t, alpha, feature = marched.samples
        kernels.in_parallel(
            kernels.march_back, n, self.threads, rays.origins, rays.directions, np.float32(field.step),
            np.float32(field.step * field.scale), field.grid.sizes, field.grid.roots, field.grid.starts,
            field.grid.table, np.float32(field.shift), first, count, t, alpha, feature, marched.channels, marched.through,
            grad_channels, grad_through, np.float32(LEAST), np.float32(LIGHTEST), self.gradient, touched,
        )  # fmt: skip
        self._move(touched, [g.sum(0) for g in grads], rates)

    def _move(self, touched: np.ndarray, network_gradient: list, rates: Rates) -> None:
        kernels.in_parallel(
            kernels.move, len(touched), self.threads, self.field.grid.values, self.gradient, self.past, touched,
            rates.voxel, np.float32(BETA2), np.float32(self.unbiased), np.float32(EPSILON), np.float32(KEPT), np.float32(SLIGHT), np.float32(self.most),
        )  # fmt: skip
        self.adam(network_gradient, rates.network)
