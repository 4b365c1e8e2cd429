"""The kernels against the same maths in torch: what they composite, and every gradient."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from fields import random_field

from scene.field import Field, kernels, volume
from scene.field.descent import KernelDescent, Rates
from scene.field.grid import BRICK, interpolate
from scene.field.kernels import WEIGHT
from scene.field.occupancy import Occupancy, cells, contract


@pytest.fixture
def field():
    return random_field(0.5)


@pytest.fixture
def rays(field):
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(40, 3))
    origins *= 2.2 / np.linalg.norm(origins, axis=1, keepdims=True)
    towards = rng.uniform(-0.8, 0.8, (40, 3)) - origins
    return field.rays(origins, towards / np.linalg.norm(towards, axis=1, keepdims=True))


class Twin:
    """A field in torch, in float64, on the samples the kernel took."""

    def __init__(self, field):
        self.field = field
        self.values = torch.tensor(field.grid.values, dtype=torch.float64, requires_grad=True)
        self.inner, self.outer = (torch.tensor(p, dtype=torch.float64, requires_grad=True) for p in field.shading.parameters)

    def composite(self, rays, marched, k):
        first, count, t, _, _ = marched.samples
        t = torch.tensor(t[first[k] : first[k] + count[k]], dtype=torch.float64)
        o, d = (torch.tensor(a[k], dtype=torch.float64) for a in (rays.origins, rays.directions))
        grid = self.field.grid
        table, roots = torch.from_numpy(grid.table), torch.from_numpy(grid.roots)
        f = interpolate(self.values, table, roots, grid.sizes, grid.starts, volume.contract(o + t[:, None] * d))
        sigma = self.field.scale * torch.nn.functional.softplus(f[:, 0] + self.field.shift)
        weights, through = volume.composite(volume.opacity(sigma, torch.tensor(self.field.step))[None])
        return (weights[0, :, None] * f[:, 1:WEIGHT]).sum(0), through[0], (weights[0].detach() * f[:, WEIGHT]).sum()

    def colour(self, rays, marched, k, behind):
        f, through, _ = self.composite(rays, marched, k)
        directions, behind = (torch.tensor(a, dtype=torch.float64)[None] for a in (rays.directions[k], behind))
        return volume.shade(f[None], through[None], directions, behind, self.inner, self.outer)[0]


def test_channels_and_transmittance_are_those_of_the_twin(field, rays):
    marched, twin = field.march(rays, keep=200), Twin(field)
    assert marched.samples[1].max() > 20
    for k in range(len(rays.near)):
        f, through, _ = twin.composite(rays, marched, k)
        np.testing.assert_allclose(marched.channels[k, 1:WEIGHT], f.detach(), atol=2e-4)
        np.testing.assert_allclose(marched.through[k], through.item(), atol=2e-5)


def test_samples_miss_no_occupied_stretch(field, rays):
    """Skipping empty space must not skip more: no stretch of occupied cells that is two steps long goes without a sample."""
    marched = field.march(rays, keep=400)
    occupied = cells(field.occupied.mask)
    first, count, t, _, _ = marched.samples
    stretches = 0
    for k in range(len(rays.near)):
        samples = t[first[k] : first[k] + count[k]]
        end = samples[-1] if marched.through[k] < 0.02 else 4.0  # where it is dark, the ray ends
        fine = np.arange(0.2, end, 0.002)
        places = contract(rays.origins[k] + fine[:, None] * rays.directions[k])
        on = occupied[tuple(np.clip(((places + 2) * 4).astype(int), 0, 15).T)]
        length = np.append(0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
        for run in np.split(np.arange(len(fine)), np.flatnonzero(np.diff(on)) + 1):
            if len(run) and on[run[0]] and np.ptp(length[run]) > 2 * field.step:
                stretches += 1
                assert ((samples >= fine[run[0]] - 1e-3) & (samples <= fine[run[-1]] + 1e-3)).any()
    assert stretches > 20


def test_gradients_of_voxels_and_network_are_those_of_the_twin(field, rays, monkeypatch):
    n = len(rays.near)
    rng = np.random.default_rng(2)
    target, behind = rng.random((n, 3)).astype(np.float32), rng.random((n, 3)).astype(np.float32)
    found = {}

    def caught(self, touched, network, rates):
        found["voxels"], found["network"], found["touched"] = self.gradient.copy(), network, touched.copy()

    monkeypatch.setattr(KernelDescent, "_move", caught)
    monkeypatch.setattr("scene.field.descent.LEAST", 0.0)
    descent = KernelDescent(field, threads=1)
    bits = [np.zeros_like(field.occupied.mask) for _ in range(2)]
    jitter = np.full(n, 0.5, np.float32)
    descent.step(rays, target, behind, jitter, Rates(1, 1, 1, 1), *bits, 0.1)
    marched, twin = field.march(rays, keep=400), Twin(field)
    colours = torch.stack([twin.colour(rays, marched, k, behind[k]) for k in range(n)])
    weighed = sum(twin.composite(rays, marched, k)[2] for k in range(n))  # its gradient: by how much each voxel was seen
    (((colours - torch.tensor(target, dtype=torch.float64)) ** 2).sum() + weighed).backward()
    expected = twin.values.grad.numpy()
    expected[: BRICK**3] = 0  # brick 0 is never trained
    np.testing.assert_allclose(found["voxels"][BRICK**3 :], expected[BRICK**3 :], atol=3e-4 * np.abs(expected).max())
    for mine, true in zip(found["network"], (twin.inner.grad, twin.outer.grad)):
        np.testing.assert_allclose(mine, true, atol=3e-4 * float(true.abs().max()))
    moved = np.unpackbits(found["touched"].view(np.uint8), bitorder="little").astype(bool)
    assert moved[(np.abs(expected).max(1) > 1e-6)].all()


def test_samples_that_are_hardly_seen_and_whose_gradients_are_small_move_nothing(field, rays, monkeypatch):
    monkeypatch.setattr("scene.field.descent.LEAST", np.inf)
    monkeypatch.setattr("scene.field.descent.LIGHTEST", np.inf)
    before = field.grid.values.copy()
    n = len(rays.near)
    bits = [np.zeros_like(field.occupied.mask) for _ in range(2)]
    jitter, colours = np.full(n, 0.5, np.float32), np.zeros((n, 3), np.float32)
    KernelDescent(field, threads=1).step(rays, colours, colours, jitter, Rates(1, 1, 1, 1), *bits, 0.1)
    np.testing.assert_array_equal(field.grid.values, before)


@pytest.mark.parametrize("inside", [slice(12, 20), slice(6, 26)])  # within the box and beyond it
def test_rays_end_where_nothing_more_is_occupied(field, rays, inside, monkeypatch):
    occupied = np.zeros((32, 32, 32), bool)
    occupied[inside, inside, inside] = True
    inner = replace(field, occupied=Occupancy.of(occupied))
    ended = inner.march(rays)
    assert (inner.end(rays, np.full(len(rays.near), 1e4, np.float32)) < 100).all()
    monkeypatch.setattr(Field, "end", lambda self, rays, far: far)
    endless = inner.march(rays)
    np.testing.assert_array_equal(ended.channels, endless.channels)
    np.testing.assert_array_equal(ended.distance, endless.distance)


def test_no_depth_lies_beyond_far(field, rays):
    """The sample before ``far`` stands for half a step beyond it, too."""
    surface = field.march(rays).distance
    far = np.nan_to_num(surface - 0.1 * field.step, nan=1.0).astype(np.float32)
    distance = field.march(rays, far=far).distance
    hit = np.isfinite(distance)
    assert hit.sum() > 5 and (distance[hit] <= far[hit]).all()


def moved(gradient, past, marked=70, most=9):
    """One step of voxels (128, 8) that are 0, all rates 0.1, the voxel ``marked`` touched: their values."""
    values, touched = np.zeros((128, 8), np.float32), np.array([0, 1 << marked - 64], np.uint64)
    numbers = (np.float32(x) for x in (0.9, 1, 0, 0.5, 0.25, most))  # beta, unbiased, epsilon, kept, slight
    kernels.move(0, 2, 0, values, gradient, past, touched, np.full(8, 0.1, np.float32), *numbers)
    assert (gradient[marked] == 0).all() and touched[1] == 0
    return values


def test_a_step_moves_touched_voxels_only():
    gradient, past = np.zeros((2, 128, 8), np.float32)
    gradient[70:72] = 0.5  # 71 is not marked
    values = moved(gradient, past)
    np.testing.assert_allclose(values[70, [0, 4, 5, 6]], -0.1 / np.sqrt(0.1), rtol=1e-5)  # RMSProp
    assert (values[:70] == 0).all() and (values[71:] == 0).all() and values[70, WEIGHT] == 0


def test_a_colour_moves_by_the_mean_residual_of_all_that_saw_it():
    gradient, past = np.zeros((2, 128, 8), np.float32)
    gradient[70, 1:4], gradient[70, WEIGHT], past[70, WEIGHT] = [0.3, -0.6, 0], 0.75, 1.0
    values = moved(gradient, past)
    np.testing.assert_allclose(values[70, 1:4], -0.1 * np.float32([0.3, -0.6, 0]) / (0.5 * 1.0 + 0.75 + 0.25), rtol=1e-5)
    assert past[70, WEIGHT] == np.float32(0.5 * 1.0 + 0.75)


def test_a_colour_moves_by_most_at_most():
    gradient, past = np.zeros((2, 128, 8), np.float32)
    gradient[70, :4], gradient[70, WEIGHT] = [0.3, 0.3, -0.6, 0.01], 0.75
    values = moved(gradient, past, most=0.02)
    np.testing.assert_allclose(values[70, :4], [-0.1 / np.sqrt(0.1), -0.02, 0.02, -0.1 * 0.01], rtol=1e-5)


def test_colours_move_little_at_first_and_more_with_every_step(field, rays, monkeypatch):
    monkeypatch.setattr("scene.field.descent.MOST", 1e-3)
    descent, dark, jitter = KernelDescent(field, threads=1), np.zeros((len(rays.near), 3), np.float32), np.zeros(len(rays.near), np.float32)
    for step in (1, 2, 3):
        before = field.grid.values[:, 1:4].copy()
        descent.step(rays, dark, dark, jitter, Rates(0, 9, 0, 0), *np.zeros((2, len(field.occupied.mask)), np.uint64), 0.1)
        assert np.abs(field.grid.values[:, 1:4] - before).max() == pytest.approx(step * 1e-3, rel=1e-3)
