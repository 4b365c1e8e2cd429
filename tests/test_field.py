"""A field learns a small scene, keeps it on disk, and refuses what is not a field."""

import pickle

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scene.camera import Camera, View, look_at, orbit
from scene.field import CHANNELS, QUANTA, Field, _rounded, _unrounded
from scene.field.descent import KernelDescent
from scene.field.volume import psnr
from scene.fit import fit

SIZE = 48


def checkerboard(camera):
    """A unit checkerboard in the plane z = 0 before a white backdrop: picture and true depth."""
    origins, directions = camera.rays(camera.pixel_centres())
    t = -origins[..., 2] / directions[..., 2]
    places = origins + t[..., None] * directions
    on = (t > 0) & (np.abs(places[..., :2]) < 0.5).all(-1)
    cells = (np.floor(places[..., :2] * 4).sum(-1) % 2).astype(bool)
    image = np.where(cells[..., None], np.uint8([200, 60, 40]), np.uint8([40, 90, 160]))
    image[~on] = 255
    return image.astype(np.uint8), np.where(on, t * (directions @ camera.forward), np.nan)


def cameras(count=14):
    poses = [pose for elevation in (35, 60) for pose in orbit((0, 0, 0), 2.0, elevation, count // 2, start_deg=elevation)]
    return [Camera.from_fov(pose, SIZE, SIZE, 40) for pose in poses]


@pytest.fixture(scope="module")
def views():
    return [View(f"{i:02d}", camera, checkerboard(camera)[0]) for i, camera in enumerate(cameras())]


@pytest.fixture(scope="module")
def field(views):
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), np.zeros(300)])
    return fit(views, points=points, steps=400, seed=0, progress=False, deterministic=True)


@pytest.fixture(scope="module")
def new_view():
    return Camera.from_fov(look_at((1.2, 0.5, 1.4), (0, 0, 0)), SIZE, SIZE, 40)


def test_a_view_that_was_not_trained_on_looks_right(field, new_view):
    image, _ = field.render(new_view)
    assert image.shape == (SIZE, SIZE, 3) and image.dtype == np.uint8
    assert psnr(image, checkerboard(new_view)[0]) > 15  # seconds of training, coarse voxels


def test_the_depth_of_a_plane_is_right(field, new_view):
    _, depth = field.render(new_view)
    true = checkerboard(new_view)[1]
    both = np.isfinite(depth) & np.isfinite(true)
    assert both.sum() > 0.8 * np.isfinite(true).sum()
    assert np.median(np.abs(depth - true)[both]) < 0.06  # less than two voxels


def test_hardly_anything_floats_beside_a_plane(field):
    """Two pixels and more from the checkerboard, in views from other heights than the photographs'."""
    floating = []
    for pose in [pose for elevation in (25, 50) for pose in orbit((0, 0, 0), 2.2, elevation, 6, start_deg=elevation)]:
        camera = Camera.from_fov(pose, SIZE, SIZE, 40)
        beside = cv2.erode(np.isnan(checkerboard(camera)[1]).astype(np.uint8), np.ones((5, 5)), borderValue=1).astype(bool)
        floating.append(np.isfinite(field.render(camera)[1])[beside])
    assert np.concatenate(floating).mean() < 0.05  # seconds of training


def test_only_what_lies_between_near_and_far_is_seen(field, new_view):
    image, depth = field.render(new_view)
    middle = float(np.nanmedian(depth))
    cut, kept = field.render(new_view, far=middle)
    assert np.nanmax(kept) <= middle + 0.02 and np.median(np.abs(cut.astype(int) - image)[depth < middle - 0.05]) <= 2
    _, behind = field.render(new_view, near=middle)
    assert np.nanmin(behind) >= middle - 0.02


def test_what_is_saved_is_what_is_loaded(field, new_view, tmp_path):
    field.save(tmp_path / "field.pt")
    again, depth = Field.load(tmp_path / "field.pt").render(new_view)
    image, _ = field.render(new_view)
    assert psnr(again, image) > 45  # a file rounds the voxels
    assert [path.name for path in tmp_path.iterdir()] == ["field.pt"]


@settings(max_examples=20, deadline=None)
@given(arrays(np.float32, (5, CHANNELS), elements=st.floats(-3000, 3000, width=32)))
def test_a_file_rounds_voxels_to_less_than_a_quantum(values):
    again = _unrounded(_rounded(values))
    within = np.abs(values) < 32000 * QUANTA
    assert (np.abs(again - values)[within] <= np.broadcast_to(0.51 * QUANTA, values.shape)[within]).all()
    assert (np.abs(again) <= 32640 * QUANTA).all()  # what is larger is cut off


def test_voxels_of_another_kind_are_refused(field, tmp_path):
    path = tmp_path / "field.pt"
    field.save(path)
    with np.load(path) as file:
        whole = {key: file[key] for key in file.files}
    for wrong in (whole["values"].astype(np.float32), whole["values"][:, :, :-64]):
        with open(path, "wb") as file:
            np.savez(file, **{**whole, "values": wrong})
        with pytest.raises(ValueError, match="damaged"):
            Field.load(path)
    with open(path, "wb") as file:
        np.savez(file, **{**whole, "version": 2})
    with pytest.raises(ValueError, match="no field of version 4; train it again"):
        Field.load(path)


def test_a_truncated_or_foreign_file_is_refused(field, tmp_path):
    path = tmp_path / "field.pt"
    field.save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match="field"):
        Field.load(path)
    for foreign in (b"", b"not a field", pickle.dumps({"version": 3})):
        path.write_bytes(foreign)
        with pytest.raises(ValueError, match="field.pt is not a field, or was cut off; train it again") as refused:
            Field.load(path)
        assert "pickle" not in str(refused.value)


def test_pictures_of_different_exposure_teach_the_scene_as_their_mean_shows_it(views, new_view):
    gains = np.random.default_rng(0).uniform(0.45, 1.0, (len(views), 3))
    shown = [View(v.name, v.camera, (v.image * gain).astype(np.uint8)) for v, gain in zip(views, gains)]
    expected = (checkerboard(new_view)[0] * np.exp(np.log(gains).mean(0))).astype(np.uint8)
    points = np.column_stack([np.random.default_rng(1).uniform(-0.5, 0.5, (300, 2)), np.zeros(300)])
    settings = dict(points=points, steps=300, seed=0, progress=False, deterministic=True)
    known, unknown = (psnr(fit(shown, **settings, exposure=exposure).render(new_view)[0], expected) for exposure in (True, False))
    assert known > unknown + 2


def test_one_photograph_is_not_enough(views):
    with pytest.raises(ValueError, match="two photographs"):
        fit(views[:1], steps=1, progress=False)


def test_the_same_seed_on_one_thread_gives_the_same_field(views, new_view):
    first, second = (fit(views, steps=20, seed=3, progress=False, deterministic=True) for _ in range(2))
    np.testing.assert_array_equal(first.render(new_view)[0], second.render(new_view)[0])


def test_a_killed_training_goes_on_to_the_same_field(views, new_view, tmp_path, monkeypatch):
    from scene import fit as training

    monkeypatch.setattr(training, "SAVE_EVERY", 0.0)
    settings = dict(steps=40, seed=3, deterministic=True, progress=False)
    whole = fit(views, **settings)

    def killed(field, step, seconds):
        if step == 25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(views, **settings, checkpoint=tmp_path / "checkpoint.npz", callback=killed)
    steps = []
    again = fit(views, **settings, checkpoint=tmp_path / "checkpoint.npz", callback=lambda field, step, seconds: steps.append(step))
    assert steps[0] > 20
    np.testing.assert_array_equal(whole.grid.values, again.grid.values)
    np.testing.assert_array_equal(whole.render(new_view)[0], again.render(new_view)[0])
    assert not list(tmp_path.iterdir())


def test_rays_come_to_begin_nearer_as_training_goes_on(views, monkeypatch):
    begun = []
    step = KernelDescent.step
    monkeypatch.setattr(KernelDescent, "step", lambda self, rays, *rest: begun.append(float(rays.near.max())) or step(self, rays, *rest))
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3)) * [1, 1, 0]
    fit(views, points=points, steps=20, seed=0, progress=False)
    assert (np.diff(begun) <= 0).all() and begun[5] == begun[0] > 0 and begun[-1] == pytest.approx(0.1 * begun[0])
