"""One step of gradient descent on a field, with the kernels of `scene.kernels`."""

from dataclasses import dataclass

import numpy as np

from scene import kernels
from scene.field import Field, Rays
from scene.grid import BRICK, lengthened

BETA1, BETA2 = 0.9, 0.99
BACKGROUND_FASTER = 10
NOISE = 0.0
DISTORTION = 0.0
EPSILON = 1e-5


@dataclass(frozen=True)
class Rates:
    """Adam's learning rates: of raw density, diffuse colour and features of a voxel, and of the network."""

    density: float
    colour: float
    feature: float
    network: float

    @property
    def voxel(self) -> np.ndarray:
        return np.array([self.density] + [self.colour] * 3 + [self.feature] * 4, np.float32)


class KernelDescent:
    """Adam on a field's voxels and network, in place, on the CPU."""

    def __init__(self, field: Field, threads: int = kernels.THREADS):
        self.field, self.threads, self.steps, self.keep = field, threads, 0, 128
        self.gradient = np.zeros_like(field.grid.values)
        self.mean, self.square = np.zeros_like(field.grid.values), np.zeros_like(field.grid.values)
        self.network = [(np.zeros_like(p), np.zeros_like(p)) for p in field.shading.parameters]

    def grown(self) -> None:
        """The field's grid has got more voxels, behind the ones it had."""
        count = len(self.field.grid.values)
        self.mean, self.square = lengthened(self.mean, count), lengthened(self.square, count)
        self.gradient = np.zeros_like(self.field.grid.values)

    def step(self, rays: Rays, target: np.ndarray, jitter: np.ndarray, rates: Rates, huber: float, seen: np.ndarray, visible: float):
        """One step on rays and their colours (n, 3); notes the largest weight of each cell in ``seen``. Returns the MSE."""
        marched = self.field.march(rays, jitter=jitter, keep=self.keep, seen=seen, visible=visible, threads=self.threads)
        count = int(marched.samples[1].sum())
        self.keep = int(1.3 * count / len(target)) + 16
        noise = np.random.default_rng(self.steps).uniform(-NOISE, NOISE, (len(target), 3)).astype(np.float32)
        plain = marched.channels
        marched.channels = plain.copy()
        marched.channels[:, 1:4] += marched.through[:, None] * noise
        error = self.field.shade(marched, rays, self.threads) - target
        self.steps += 1
        self._back(rays, marched, np.clip(error, -huber, huber) * np.float32(2), rates, plain, noise)
        return float(np.mean(error**2))

    def _back(self, rays: Rays, marched, grad_colour: np.ndarray, rates: Rates, plain, noise) -> None:
        field, n = self.field, len(grad_colour)
        grad_channels, grad_through = np.empty_like(marched.channels), np.empty_like(marched.through)
        grads = [np.zeros((self.threads, *p.shape), np.float32) for p in field.shading.parameters]
        kernels.in_parallel(
            kernels.shade_back, n, self.threads, marched.channels, marched.through, rays.directions,
            *field.shading.parameters, grad_colour, grad_channels, grad_through, *grads,
        )  # fmt: skip
        grad_through += (grad_channels[:, 1:4] * noise).sum(1)
        touched = np.zeros(len(self.mean) // BRICK**3, np.uint64)
        first, count, t, stretch, alpha, feature = marched.samples
        kernels.in_parallel(
            kernels.march_back, n, self.threads, rays.origins, rays.directions, np.float32(field.step),
            np.float32(field.step * field.scale), field.grid.sizes, field.grid.table, field.grid.starts,
            np.float32(field.shift), np.float32(DISTORTION), first, count, t, stretch, alpha, feature, plain, marched.through,
            grad_channels, grad_through, self.gradient, touched,
        )  # fmt: skip
        self._move(touched, [g.sum(0) for g in grads], rates)

    def _move(self, touched: np.ndarray, network_gradient: list, rates: Rates) -> None:
        correction = np.sqrt(1 - BETA2**self.steps) / (1 - BETA1**self.steps)
        kernels.in_parallel(
            kernels.adam, len(touched), self.threads, self.field.grid.values, self.gradient, self.mean, self.square,
            touched, rates.voxel, np.float32(BETA1), np.float32(BETA2), np.float32(correction), np.float32(EPSILON),
        )  # fmt: skip
        faster = (BACKGROUND_FASTER, 1, 1)  # before fog explains the backdrop
        for p, g, (mean, square), by in zip(self.field.shading.parameters, network_gradient, self.network, faster):
            mean += (1 - BETA1) * (g - mean)
            square += (1 - BETA2) * (g**2 - square)
            p -= (by * rates.network * correction * mean / (np.sqrt(square) + 1e-12)).astype(np.float32)

    def state(self) -> dict:
        """Everything that `restore` needs beside the field."""
        moments = {f"network{i}{k}": m for i, pair in enumerate(self.network) for k, m in enumerate(pair)}
        return {"steps": self.steps, "keep": self.keep, "mean": self.mean, "square": self.square, **moments}

    def restore(self, state: dict) -> None:
        self.steps, self.keep = int(state["steps"]), int(state["keep"])
        self.mean, self.square = state["mean"], state["square"]
        self.gradient = np.zeros_like(self.mean)
        self.network = [tuple(state[f"network{i}{k}"] for k in range(2)) for i in range(len(self.network))]
