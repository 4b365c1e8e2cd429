"""The twin in torch finds what the kernels find, learns what they learn, and either goes on where the other stopped."""

import warnings
from copy import deepcopy

import numpy as np
import pytest
import torch
from fields import random_field

from scene import fit as training
from scene.camera import Camera, View, look_at, orbit
from scene.field import Field, walk
from scene.field.descent import KernelDescent, Rates
from scene.field.device import chosen
from scene.field.grid import BRICK
from scene.field.occupancy import contract
from scene.field.torch_descent import TorchDescent
from scene.field.volume import psnr
from scene.fit import fit

GPU = pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU"))
RAYS = 1000


@pytest.fixture(params=["torch", GPU])
def device(request):
    return request.param


@pytest.fixture
def field():
    return random_field(0.4)


@pytest.fixture
def rays(field):
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(RAYS, 3))
    origins *= rng.uniform(0.5, 2.2, (RAYS, 1)) / np.linalg.norm(origins, axis=1, keepdims=True)
    towards = rng.uniform(-0.8, 0.8, (RAYS, 3)) - origins
    return field.rays(origins, towards / np.linalg.norm(towards, axis=1, keepdims=True))


def notes(field):
    return [np.zeros_like(field.occupied.mask) for _ in range(2)]


def differing(bits, others):
    return np.unpackbits((bits ^ others).view(np.uint8)).sum()


def test_both_take_the_same_samples_and_note_the_same_cells(field, rays, device):
    """But for a sample in a million, which rounding puts into the next cell: all that follow on its ray are others then."""
    jitter = np.random.default_rng(2).random(RAYS, np.float32)
    seen, seen_by_twin = notes(field), notes(field)
    mine = field.march(rays, jitter=jitter, keep=200, seen=seen[0], surface=seen[1], threads=1)
    twins = field.on(device).march(rays, jitter=jitter, keep=200, seen=seen_by_twin[0], surface=seen_by_twin[1])
    same = np.flatnonzero(mine.samples[1] == twins.samples[1])
    assert len(same) >= 0.995 * RAYS and mine.samples[1].mean() > 20
    off = []
    for k in same:
        places = [
            contract(rays.origins[k] + t[first[k] : first[k] + count[k], None] * rays.directions[k])
            for first, count, t, _, _ in (mine.samples, twins.samples)
        ]
        off.append(np.abs(places[0] - places[1]).max(initial=0))
    assert np.mean(np.array(off) < 2e-3 * field.step) > 0.99
    for bits, others in zip(seen, seen_by_twin):
        assert differing(bits, others) <= 3 and differing(bits, np.zeros_like(bits)) > 300


def test_both_composite_the_same(field, rays, device):
    far = np.full(RAYS, 2.5, np.float32)
    for limits in ({}, {"far": far}):
        mine, twins = field.march(rays, **limits), field.on(device).march(rays, **limits)
        close = np.abs(mine.channels - twins.channels).max(1) < 2e-3
        assert close.mean() >= 0.995 and (np.abs(mine.through - twins.through)[close] < 1e-3).all()
        assert (np.isnan(mine.distance) == np.isnan(twins.distance))[close].all()
        apart = np.nan_to_num(np.abs(mine.distance - twins.distance)[close]) / field.step
        assert apart.max() < 0.2 and np.quantile(apart, 0.99) < 0.01
        behind = np.random.default_rng(3).random((RAYS, 3), np.float32)
        colours = field.shade(mine, rays, behind), field.on(device).shade(mine, rays, behind)
        np.testing.assert_allclose(*colours, atol=1e-5)


def test_no_rays_and_rays_that_meet_nothing_have_answers(field, rays, device):
    twin = field.on(device)
    nothing = twin.march(field.rays(np.zeros((0, 3)), np.zeros((0, 3))))
    assert nothing.channels.shape == (0, 8) and nothing.distance.shape == (0,)
    missed = twin.march(rays, far=np.zeros(RAYS, np.float32), keep=10)
    assert (missed.through == 1).all() and (missed.samples[1] == 0).all() and np.isnan(missed.distance).all()


@pytest.mark.parametrize("most", [1e-3, 9])
def test_one_step_of_both_moves_the_same_voxels_and_weights_alike(field, rays, device, most, monkeypatch):
    """RMSProp's first step is the gradient's sign times a rate, so gradients are compared by what is kept of them, too."""
    monkeypatch.setattr("scene.field.descent.MOST", most)
    rng = np.random.default_rng(4)
    target, behind = rng.random((RAYS, 3), np.float32), rng.random((RAYS, 3), np.float32)
    jitter = rng.random(RAYS, np.float32)
    descents = KernelDescent(deepcopy(field), threads=1), TorchDescent(deepcopy(field).on(device))
    rates = Rates(0.01, 0.01, 0.01, 0.01)
    losses = [descent.step(rays, target, behind, jitter, rates, *notes(field), 0.1) for descent in descents]
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)
    mine, twins = (descent.state() for descent in descents)
    assert mine.keys() == twins.keys() and mine["steps"] == twins["steps"] and abs(mine["keep"] - twins["keep"]) <= 1
    for key in ("past", "network00", "network10", "network01", "network11"):
        scale = np.abs(mine[key]).max()
        assert np.quantile(np.abs(mine[key] - twins[key]), 0.999) < 2e-3 * scale > 0
    values, moved = (d.field.on("cpu").grid.values for d in descents)
    assert ((values != field.grid.values) == (moved != field.grid.values)).mean() > 0.999
    assert (values != field.grid.values).any(1).mean() > 0.1
    assert np.quantile(np.abs(values - moved), 0.995) < 1e-3 * rates.colour
    assert (moved[: BRICK**3] == 0).all()


def test_samples_that_are_hardly_seen_and_whose_gradients_are_small_move_nothing(field, rays, device, monkeypatch):
    monkeypatch.setattr("scene.field.descent.LEAST", np.inf)
    monkeypatch.setattr("scene.field.descent.LIGHTEST", np.inf)
    trained = deepcopy(field).on(device)
    colours, jitter = np.zeros((RAYS, 3), np.float32), np.zeros(RAYS, np.float32)
    TorchDescent(trained).step(rays, colours, colours, jitter, Rates(1, 1, 1, 1), *notes(field), 0.1)
    np.testing.assert_array_equal(trained.on("cpu").grid.values, field.grid.values)


def painted(camera):
    """A square in the plane z = 0, its colour changing smoothly, before white."""
    origins, directions = camera.rays(camera.pixel_centres())
    t = -origins[..., 2] / directions[..., 2]
    places = (origins + t[..., None] * directions)[..., :2]
    colours = 128 + 100 * np.sin(3 * places @ np.array([[1.0, 0, 1], [0, 1, 1]]))
    return np.where((np.abs(places) < 0.5).all(-1, keepdims=True), colours, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def views():
    poses = [pose for elevation in (35, 60) for pose in orbit((0, 0, 0), 2.0, elevation, 7, start_deg=elevation)]
    cameras = [Camera.from_fov(pose, 32, 32, 40) for pose in poses]
    return [View(f"{i:02d}", camera, painted(camera)) for i, camera in enumerate(cameras)]


@pytest.fixture
def small(monkeypatch):
    """Trainings of a few seconds."""
    monkeypatch.setattr(training, "BATCH", 512)
    monkeypatch.setattr(training, "PASSES", 1000)
    stages = training.Stage(0.0, (32,), 32, 1.2, 2, 20, 0.1), training.Stage(0.25, (32, 96), 64, 1.0, 1, 20, 0.2)
    return {"seed": 0, "progress": False, "stages": stages}


def test_both_learn_a_scene_equally_well(views, small, device, new_view):
    fields = [fit(views, steps=60, device=name, deterministic=name == "cpu", **small) for name in ("cpu", device)]
    quality = [psnr(field.render(new_view)[0], painted(new_view)) for field in fields]
    assert min(quality) > 14 and abs(quality[0] - quality[1]) < 0.2
    images, depths = zip(*(fields[1].on(name).render(new_view) for name in ("cpu", device)))
    assert (np.abs(images[0].astype(int) - images[1]) <= 1).mean() > 0.999
    both = np.isfinite(depths[0]) & np.isfinite(depths[1])
    assert both.sum() > 100 and np.quantile(np.abs(depths[0] - depths[1])[both], 0.98) < 1e-3  # rounding decides where thin fog's median is


@pytest.fixture(scope="module")
def new_view():
    return Camera.from_fov(look_at((1.2, 0.5, 1.4), (0, 0, 0)), 32, 32, 40)


@pytest.mark.parametrize("first", ["cpu", "twin"])
def test_one_goes_on_where_the_other_was_killed(views, small, device, new_view, tmp_path, monkeypatch, first):
    monkeypatch.setattr(training, "SAVE_EVERY", 0.0)

    def killed(field, step, seconds):
        if step == 20:
            raise KeyboardInterrupt

    order = ("cpu", device) if first == "cpu" else (device, "cpu")
    with pytest.raises(KeyboardInterrupt):
        fit(views, steps=40, device=order[0], checkpoint=tmp_path / "checkpoint.npz", callback=killed, **small)
    steps = []
    again = fit(
        views, steps=40, device=order[1], checkpoint=tmp_path / "checkpoint.npz", **small,
        callback=lambda field, step, seconds: steps.append((step, field.twin is not None)),
    )  # fmt: skip
    assert steps[0] == (20, order[1] != "cpu")
    whole = fit(views, steps=40, device="cpu", **small)
    assert psnr(again.render(new_view)[0], whole.render(new_view)[0]) > 35


def test_a_field_is_saved_and_loaded_from_and_to_any_device(field, device, tmp_path):
    field.on(device).save(tmp_path / "twin.pt")
    field.save(tmp_path / "field.pt")
    loaded = Field.load(tmp_path / "twin.pt", device=device)
    assert loaded.twin is not None and isinstance(loaded.grid.values, torch.Tensor)
    again = Field.load(tmp_path / "field.pt", device="cpu")
    np.testing.assert_array_equal(loaded.on("cpu").grid.values, again.grid.values)
    np.testing.assert_array_equal(loaded.on("cpu").shading.inner, again.shading.inner)


def one_step(field, rays):
    """The arguments of `walk.once`."""
    twin = field.on("torch").twin
    origins, directions, t = map(twin.tensor, (rays.origins, rays.directions, rays.near))
    return origins, directions, t, torch.full_like(t, 9), torch.tensor(field.step), field.occupied.size, *twin.cells(field)


def test_where_torch_cannot_compile_it_says_so_and_goes_on(field, rays, monkeypatch):
    def compiled(function, dynamic):
        def fails(*arguments):
            raise RuntimeError("Triton is missing\nand more")

        return fails

    monkeypatch.setattr(torch, "compile", compiled)
    monkeypatch.setattr(walk, "AFTER", 2)
    advance, arguments = walk.fused(torch.device("cuda")), one_step(field, rays)
    advance(*arguments)
    with pytest.warns(UserWarning, match=r"torch cannot compile for this GPU \(Triton is missing\); the field goes on"):
        found = advance(*arguments)
    for mine, expected in zip(found, walk.once(*arguments)):
        assert torch.equal(mine, expected)
    assert torch.equal(advance(*arguments)[0], found[0])


@pytest.mark.slow  # a compiler, half a minute
def test_what_torch_compiles_takes_the_same_steps(field, rays, monkeypatch):
    monkeypatch.setattr(walk, "AFTER", 1)
    arguments = one_step(field, rays)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="torch cannot compile")
        found = walk.fused(torch.device("cuda"))(*arguments)
    for mine, expected in zip(found, walk.once(*arguments)):
        assert torch.isclose(mine.float(), expected.float(), atol=1e-5).float().mean() > 0.999


def test_a_gpu_that_is_not_there_is_one_clear_error(views, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="'cuda' needs a GPU, and torch .* finds none; use 'cpu' or 'auto'"):
        fit(views, steps=1, device="cuda", progress=False)
    with pytest.raises(ValueError, match="there is no device 'gpu'; use one of 'auto', 'cpu', 'cuda'"):
        fit(views, steps=1, device="gpu", progress=False)
    assert chosen("auto") is None and chosen("cpu") is None


def test_a_gpu_is_taken_where_there_is_one(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert chosen("auto") == chosen("cuda") == torch.device("cuda", 0) and chosen("cpu") is None
    with pytest.raises(ValueError, match="no device 'cuda:1', only 1 GPU"):
        chosen("cuda:1")


def test_bit_equal_training_is_not_promised_off_the_cpu(views):
    with pytest.raises(ValueError, match="bit-equal on the CPU only"):
        fit(views, steps=1, device="torch", deterministic=True, progress=False)
