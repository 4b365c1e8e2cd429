"""One step of gradient descent on a field in torch, for a GPU: the twin of `scene.field.descent.KernelDescent`."""

import numpy as np
import torch

from scene.field import FAR, STOP_TRAINING, Field, Rays, descent, twin, volume
from scene.field.descent import Descent, Rates
from scene.field.grid import BRICK, corners
from scene.field.kernels import WEIGHT


class TorchDescent(Descent):
    """On the device of ``field.twin``. What the grid says at a sample is linear in its voxels: autograd gives the loss's gradient
    in what the samples found, and each sample hands its own on to the eight voxels around it on each level."""

    threads = 1

    def __init__(self, field: Field):
        super().__init__(field)
        self.touched = self._none_touched()

    def _none_touched(self) -> torch.Tensor:
        return torch.zeros(len(self.past), dtype=torch.bool, device=self.past.device)

    def grown(self) -> None:
        super().grown()
        self.touched = self._none_touched()

    def restore(self, state: dict) -> None:
        super().restore(state)
        self.touched = self._none_touched()

    def step(self, rays: Rays, target, behind, jitter, rates: Rates, seen: np.ndarray, surface: np.ndarray, visible: float) -> float:
        """`KernelDescent.step`."""
        field, marcher = self.field, self.field.twin
        samples = marcher.gather(field, rays, field.end(rays, np.full(len(target), FAR, np.float32)), jitter, STOP_TRAINING)
        self.keep = int(1.3 * len(samples.t) / len(target)) + 16  # for the kernels, if they go on with this training
        network = [p.clone().requires_grad_() for p in field.shading.parameters]
        samples.feature.requires_grad_()
        composed = marcher.composite(field, samples)
        behind, target, directions = map(marcher.tensor, (behind, target, rays.directions))
        error = volume.shade(composed.channels, composed.through, directions, behind, *network) - target
        (error**2).sum().backward()
        marcher.note(field, samples, composed, seen, surface, visible)
        self._scatter(samples, composed.weights.detach()[samples.ray, samples.slot])
        self.steps += 1
        self._move([p.grad for p in network], rates)
        return float((error.detach() ** 2).mean())

    def _scatter(self, samples: twin.Samples, weights: torch.Tensor) -> None:
        """Add the samples' gradients, and by which weights (m,) they were seen, to those of their voxels; note which voxels they touch."""
        grid, (table, roots) = self.field.grid, self.field.twin.index(self.field)
        teaches = (samples.feature.grad.abs().amax(1) >= descent.LEAST) | (weights >= descent.LIGHTEST)
        gradient = torch.cat([samples.feature.grad[:, :WEIGHT], weights[:, None]], 1)[teaches]
        pieces = zip(samples.place[teaches].split(twin.GATHER), gradient.split(twin.GATHER))
        for place, grad in pieces:
            for size, start in zip(map(int, grid.sizes), map(int, grid.starts)):
                rows, weights = corners(table, roots, size, start, place)
                rows = rows.flatten()
                self.gradient.index_add_(0, rows, (weights[..., None] * grad[:, None]).flatten(0, 1))
                self.touched[rows] = True

    def _move(self, network_gradient: list, rates: Rates) -> None:
        """A step of the touched voxels, see `kernels.move`; brick 0 stands for all that is not kept and is not moved."""
        self.touched[: BRICK**3] = False
        rows = self.touched.nonzero()[:, 0]
        g, rate = self.gradient[rows], self.field.twin.tensor(rates.voxel)
        past = descent.BETA2 * self.past[rows] + (1 - descent.BETA2) * g**2
        past[:, WEIGHT] = descent.KEPT * self.past[rows, WEIGHT] + g[:, WEIGHT]
        self.past[rows] = past
        step = rate * self.unbiased * g / (past.sqrt() + descent.EPSILON)
        step[:, 1:4] = (rate[1:4] * g[:, 1:4] / (past[:, WEIGHT, None] + descent.SLIGHT)).clamp(-self.most, self.most)
        self.field.grid.values[rows] -= step
        self.gradient[rows] = 0
        self.gradient[: BRICK**3] = 0
        self.touched[rows] = False
        self.adam(network_gradient, rates.network)
