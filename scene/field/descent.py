"""One step of gradient descent on a field, with the kernels of `scene.field.kernels`."""

from dataclasses import dataclass

import numpy as np

from scene.field import Field, Rays, kernels
from scene.field.grid import BRICK, lengthened

BETA1, BETA2 = 0.9, 0.99
EPSILON = 1e-5
LEAST = 1e-3
"""Samples with smaller gradients (of a squared colour error) are left out: RMSProp would move their voxels as far as those of a surface."""


@dataclass(frozen=True)
class Rates:
    """Learning rates: of raw density, diffuse colour and features of a voxel, and of the network."""

    density: float
    colour: float
    feature: float
    network: float

    @property
    def voxel(self) -> np.ndarray:
        return np.array([self.density] + [self.colour] * 3 + [self.feature] * 4, np.float32)


class KernelDescent:
    """RMSProp on a field's voxels and Adam on its network, in place, on the CPU.

    A voxel is moved only when rays meet it, seldom and with long breaks: a mean of its past gradients would say little.
    """

    def __init__(self, field: Field, threads: int = kernels.THREADS):
        self.field, self.threads, self.steps, self.keep = field, threads, 0, 128
        self.gradient = np.zeros_like(field.grid.values)
        self.square = np.zeros_like(field.grid.values)
        self.network = [(np.zeros_like(p), np.zeros_like(p)) for p in field.shading.parameters]

    def grown(self) -> None:
        """The field's grid has got more voxels, behind the ones it had."""
        count = len(self.field.grid.values)
        self.square = lengthened(self.square, count)
        self.gradient = np.zeros_like(self.field.grid.values)

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
            kernels.shade_back, n, self.threads, marched.channels, marched.through, rays.directions,
            behind, *field.shading.parameters, grad_colour, grad_channels, grad_through, *grads,
        )  # fmt: skip
        touched = np.zeros(len(self.square) // BRICK**3, np.uint64)
        first, count, t, alpha, feature = marched.samples
        kernels.in_parallel(
            kernels.march_back, n, self.threads, rays.origins, rays.directions, np.float32(field.step),
            np.float32(field.step * field.scale), field.grid.sizes, field.grid.roots, field.grid.starts,
            field.grid.table, np.float32(field.shift), first, count, t, alpha, feature, marched.channels, marched.through,
            grad_channels, grad_through, np.float32(LEAST), self.gradient, touched,
        )  # fmt: skip
        self._move(touched, [g.sum(0) for g in grads], rates)

    def _move(self, touched: np.ndarray, network_gradient: list, rates: Rates) -> None:
        unbiased = np.sqrt(1 - BETA2**self.steps)
        correction = unbiased / (1 - BETA1**self.steps)
        kernels.in_parallel(
            kernels.rmsprop, len(touched), self.threads, self.field.grid.values, self.gradient, self.square,
            touched, rates.voxel, np.float32(BETA2), np.float32(unbiased), np.float32(EPSILON),
        )  # fmt: skip
        for p, g, (mean, square) in zip(self.field.shading.parameters, network_gradient, self.network):
            mean += (1 - BETA1) * (g - mean)
            square += (1 - BETA2) * (g**2 - square)
            p -= (rates.network * correction * mean / (np.sqrt(square) + 1e-12)).astype(np.float32)

    def state(self) -> dict:
        """Everything that `restore` needs beside the field."""
        moments = {f"network{i}{k}": m for i, pair in enumerate(self.network) for k, m in enumerate(pair)}
        return {"steps": self.steps, "keep": self.keep, "square": self.square, **moments}

    def restore(self, state: dict) -> None:
        self.steps, self.keep = int(state["steps"]), int(state["keep"])
        self.square = state["square"]
        self.gradient = np.zeros_like(self.square)
        self.network = [tuple(state[f"network{i}{k}"] for k in range(2)) for i in range(len(self.network))]
