import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from teach.bundle import COUNT, ViewedStroke, adjust, hand_faults, pinned, solve, starts, triangulate
from teach.curve import resample
from teach.epipolar import at
from teach.metrics import frechet
from teach.quality import level

TARGET = np.array([0.5, 0.0, 0.4])
EYES = ((-0.3, -0.9, 0.9), (1.3, -0.7, 0.8), (0.4, 1.0, 1.1))
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in EYES]
U = np.linspace(0, 1, COUNT)


def hook(s):
    return TARGET + np.stack([0.25 * np.cos(4 * s) - 0.05, 0.25 * np.sin(4 * s), 0.2 * s - 0.1], axis=-1)


def arc(pixels):
    """A stroke at even arc lengths (COUNT, 2)."""
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    return np.stack([np.interp(U, s / s[-1], axis) for axis in pixels.T], axis=1)


def views(count=2, noise=0.0):
    rng = np.random.default_rng(0)
    strokes = [arc(camera.project(hook(np.linspace(0, 1, 1000)))) for camera in CAMERAS[:count]]
    return [
        ViewedStroke.of(camera, stroke + noise * rng.standard_normal((3, COUNT, 2)))
        for camera, stroke in zip(CAMERAS, strokes)
    ]


def off(points):
    """Largest distance [m] of points from the curve."""
    return np.linalg.norm(points[:, None] - hook(np.linspace(0, 1, 2000)), axis=-1).min(axis=1).max()


def test_rays_of_one_point_meet_there():
    x = hook(U)
    assert np.abs(triangulate([c.project(x) for c in CAMERAS], CAMERAS) - x).max() < 1e-6
    assert np.abs(triangulate([c.project(x) for c in CAMERAS[:2]], CAMERAS[:2]) - x).max() < 1e-6


@pytest.mark.parametrize("count, bound", [(2, 0.005), (3, 0.003)])
def test_exact_strokes_give_the_curve_though_each_view_has_its_own_arc_length(count, bound):
    bundle = adjust(views(count), None if count == 2 else np.zeros((count, COUNT)))
    assert off(bundle.points) < bound
    equal = triangulate([view.mean for view in views(count)], CAMERAS[:count])
    assert off(equal) > 8 * off(bundle.points)


def test_white_noise_of_a_pixel_does_little():
    assert off(adjust(views(2, noise=1.0)).points) < 0.01


def test_lags_say_which_point_of_a_stroke_shows_a_point_of_the_curve():
    bundle = adjust(views(2))
    for view, lag in zip(views(2), bundle.lags):
        miss = at(view.mean, U + lag) - view.camera.project(bundle.points)
        assert np.abs(miss).max() < 1.0


def test_evidence_prefers_the_right_correspondence():
    two = views(2)
    right = adjust(two)
    wrong = [solve(two, np.stack([lag, -lag]), 0.03, 1.5, steps=0) for lag in (0.15 * np.sin(np.pi * U), -0.2 * np.sin(np.pi * U))]
    assert right.evidence > max(bundle.evidence for bundle in wrong) + 10


def test_starts_are_pinned_at_both_ends():
    for lags in starts(*views(2)):
        assert np.allclose(lags[:, [0, -1]], 0) and lags.shape == (2, COUNT)
    K = pinned(np.exp(-((U[:, None] - U) ** 2)))
    assert np.allclose(K[[0, -1]], 0) and np.linalg.eigvalsh(K).min() > -1e-9


def test_the_faults_of_a_hand_are_those_of_people_and_scale_with_the_strokes_spread():
    stroke = views(1)[0].mean
    E = hand_faults(stroke)
    offset = np.ones(COUNT) / COUNT
    assert np.sqrt(sum(offset @ e @ offset for e in E)) > 0.03 * np.ptp(stroke, axis=0).max()
    assert all(np.linalg.eigvalsh(e).min() > -1e-9 for e in E)
    rng = np.random.default_rng(1)
    near, far = (ViewedStroke.of(CAMERAS[0], stroke + rng.normal(0, size, (3, 1, 2))) for size in (2.0, 20.0))
    assert far.sigma > 1.4 * near.sigma


def wave(seed):
    """A smooth motion (300, 3) of about 0.4 m."""
    rng, s = np.random.default_rng(seed), np.linspace(0, 1, 300)[:, None]
    parts = [rng.normal(0, 0.12 / k, 3) * np.cos(np.pi * k * s) for k in (1, 2, 3)]
    return TARGET + sum(parts)


def pair(azimuth, apart, heights):
    """Two cameras around the target; angles [deg]."""
    angles, up = np.radians([azimuth, azimuth + apart]), np.radians(heights)
    eyes = 1.5 * np.stack([np.cos(angles) * np.cos(up), np.sin(angles) * np.cos(up), np.sin(up)], axis=1) + TARGET
    return [Camera.from_fov(look_at(eye, TARGET), 640, 480, 60) for eye in eyes]


def drawn(curve, camera, count=1):
    return ViewedStroke.of(camera, [resample(camera.project(curve), COUNT)] * count)


@settings(max_examples=8, derandomize=True, deadline=None)
@given(
    st.integers(0, 10_000), st.floats(0, 360), st.floats(30, 110),
    st.tuples(st.floats(10, 55), st.floats(10, 55)), st.integers(1, 3),
)  # fmt: skip
def test_strokes_drawn_exactly_meet_in_the_curve_and_its_pictures_are_the_strokes(seed, azimuth, apart, heights, count):
    curve, cameras = wave(seed), pair(azimuth, apart, heights)
    strokes = [drawn(curve, camera, count) for camera in cameras]
    bundle = adjust(strokes)
    for stroke, lag in zip(strokes, bundle.lags):
        seen = at(stroke.mean, U + lag) - stroke.camera.project(bundle.points)
        assert np.linalg.norm(seen, axis=1).max() < 3.0
    if level(cameras, resample(curve, COUNT)).mean() < 0.3:  # where geometry says which points are the same
        assert 1000 * frechet(resample(bundle.points, 200), resample(curve, 200)) < 12


def test_a_motion_along_the_line_between_the_cameras_is_found_where_its_strokes_are_exact():
    s = np.linspace(0, 1, 400)[:, None]
    curve = np.hstack([0.1 * np.sin(3 * s), 0.5 * s - 0.25, 0.05 + 0.5 * s * (1 - s)])
    cameras = [Camera.from_fov(look_at(eye, [0, 0, 0.1]), 640, 480, 50) for eye in ([1.0, 0.7, 0.8], [0.9, -0.8, 0.9])]
    bundle = adjust([drawn(curve, camera) for camera in cameras])
    assert frechet(resample(bundle.points, 200), resample(curve, 200)) < 0.006
