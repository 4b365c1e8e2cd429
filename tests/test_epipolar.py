import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from teach.epipolar import fundamental, lag_between, sampson
from teach.lag import at, lag_behind

TARGET = np.array([0.5, 0.0, 0.4])
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in ((-0.3, -0.9, 0.9), (1.3, -0.7, 0.8))]
U = np.linspace(0, 1, 100)


def hook(s):
    return TARGET + np.stack([0.25 * np.cos(4 * s) - 0.05, 0.25 * np.sin(4 * s), 0.2 * s - 0.1], axis=-1)


def test_points_of_one_place_satisfy_the_fundamental_matrix():
    a, b = (camera.project(hook(U)) for camera in CAMERAS)
    F = fundamental(*CAMERAS)
    assert np.abs(sampson(a, b, F)).max() < 1e-9
    normal = F @ np.append(a[0], 1)
    moved = b[:1] + normal[:2] / np.linalg.norm(normal[:2])  # one pixel off the epipolar line, shared by two pictures
    assert 0.5 < abs(sampson(a[:1], moved, F)[0]) < 1


def test_a_curve_is_read_between_its_points_and_goes_on_straight():
    line = np.array([[0.0, 0], [1, 2], [2, 4]])
    assert np.allclose(at(line, [0.25, 0.5, 1.5, -0.5]), [[0.5, 1], [1, 2], [3, 6], [-1, -2]])


@given(st.floats(-0.12, 0.12), st.sampled_from([0.12, 0.25, 0.5]))
def test_the_lag_between_two_views_is_found(size, prior):
    """Both views show one curve; in one it runs ahead, in the other behind."""
    lag = size * np.sin(np.pi * U)
    warped = [np.interp(U, U + sign * lag / 2, U) for sign in (1, -1)]
    a, b = (camera.project(hook(warp)) for camera, warp in zip(CAMERAS, warped))
    found, cost = lag_between(a, b, fundamental(*CAMERAS), 1.0, prior)
    # b shows at u + l / 2 what a shows at u - l / 2; the curve runs along epipolar lines for a while
    assert np.abs(np.interp(U + found / 2, U, warped[1]) - np.interp(U - found / 2, U, warped[0])).max() < 0.06
    assert cost < 3 and found[0] == found[-1] == 0


@given(st.floats(-0.2, 0.2))
def test_the_lag_behind_a_known_motion_is_found(size):
    lag = size * np.sin(np.pi * U) ** 2
    seen = CAMERAS[0].project(hook(U))
    curve = CAMERAS[0].project(hook(np.interp(U, U + lag, U)))  # curve(u + lag) is seen(u)
    found, _ = lag_behind(curve, seen, 2.0, 0.12)
    assert np.abs(found - lag).max() < 0.03


def test_lags_never_run_backwards():
    rng = np.random.default_rng(0)
    a, b = (np.cumsum(rng.normal(0, 5, (100, 2)), axis=0) + 200 for _ in range(2))
    lag, cost = lag_between(a, b, fundamental(*CAMERAS), 3.0, 0.5)
    assert (np.diff(U + lag / 2) > 0).all() and (np.diff(U - lag / 2) > 0).all() and np.isfinite(cost)


def test_sizes_of_the_prior_matter_where_geometry_is_silent():
    s = 0.3 * (U - 0.5)
    x = TARGET + np.stack([0 * s, s, 0 * s], axis=1)
    poses = [look_at(TARGET + [0.3, y, 0.9], TARGET, up=(1, 0, 0)) for y in (-0.5, 0.5)]
    cameras = [Camera.from_fov(pose, 640, 480, 55) for pose in poses]
    lag, _ = lag_between(*(camera.project(x) for camera in cameras), fundamental(*cameras), 1.0, 0.12)
    assert np.abs(lag).max() == pytest.approx(0, abs=1e-9)  # along its own epipolar lines: equal arc length stays
