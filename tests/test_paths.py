"""Paths around, up and down, and through what was photographed."""

from types import SimpleNamespace

import numpy as np
import pytest

from scene import paths
from scene.camera import Camera, look_at, orbit

TARGET = np.array([0.4, -0.2, 0.3])


def around(poses, width=640, height=480):
    return [Camera.from_fov(pose, width, height, 55) for pose in poses]


def dome():
    """Photographs at three heights all around, in no order."""
    cameras = [camera for elevation in (15, 35, 55) for camera in around(orbit(TARGET, 1.5, elevation, 10))]
    return [cameras[i] for i in np.random.default_rng(0).permutation(len(cameras))]


def offsets(path):
    return np.stack([camera.centre for camera in path.cameras.values()]) - TARGET


def elevations(path):
    return np.degrees(np.arcsin(offsets(path)[:, 2] / np.linalg.norm(offsets(path), axis=1)))


def azimuths(path):
    return np.degrees(np.arctan2(offsets(path)[:, 1], offsets(path)[:, 0])) % 360


def steps(path):
    """Distance [m] and angle [rad] from each camera to the next."""
    poses = np.stack([camera.world_from_camera for camera in path.cameras.values()])
    turns = np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3])
    return np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1), np.arccos(np.clip((turns - 1) / 2, -1, 1))


def test_the_focus_of_cameras_that_look_at_a_point_is_that_point():
    assert paths.focus(around(orbit(TARGET, 1.5, 30, 9))) == pytest.approx(TARGET)


def test_an_orbit_keeps_the_photographs_distance_and_elevation_and_looks_at_their_focus():
    path = paths.orbit(around(orbit(TARGET, 1.5, 30, 12)), frames=7)
    assert np.linalg.norm(offsets(path), axis=1) == pytest.approx(1.5)
    assert offsets(path)[:, 2] == pytest.approx(0.75)
    assert np.stack([c.project(TARGET) for c in path.cameras.values()]) == pytest.approx(np.tile([320, 240], (7, 1)))


def test_an_orbit_closes():
    """The step from the last frame to the first is like any other."""
    path = paths.orbit(dome(), frames=24)
    ring = np.concatenate([offsets(path), offsets(path)[:1]])
    assert np.linalg.norm(np.diff(ring, axis=0), axis=1) == pytest.approx(2 * 1.5 * np.cos(np.radians(35)) * np.sin(np.pi / 24))
    assert list(path.cameras) == [f"{i:04d}" for i in range(24)]


def test_an_orbit_does_not_cross_what_nobody_photographed():
    path = paths.orbit(around(orbit(TARGET, 1.5, 30, 12, start_deg=100, sweep_deg=120)), frames=20)
    assert azimuths(path).min() == pytest.approx(100) and azimuths(path).max() == pytest.approx(220)


def test_the_best_views_are_the_pair_and_then_each_next_one():
    photographs, asked = dome(), []

    def suggest(cameras, drawn=(), *, field, workspace):
        asked.append((len(drawn), field, workspace))
        return SimpleNamespace(cameras=tuple(cameras[len(drawn) : len(drawn) + (1 if len(drawn) else 2)]))

    path = paths.best(photographs, suggest=suggest, frames=4, field="field", workspace="box")
    assert list(path.cameras.values()) == photographs[:4] and path.fps == 1.0
    assert asked == [(0, "field", "box"), (2, "field", "box"), (3, "field", "box")]
    assert len(paths.best(photographs, suggest=suggest, frames=1).cameras) == 1


def test_a_spiral_goes_around_twice_and_stays_within_the_photographs_elevations():
    path = paths.spiral(dome(), frames=200)
    assert elevations(path).min() == pytest.approx(15, abs=0.1) and elevations(path).max() == pytest.approx(55, abs=0.1)
    assert np.linalg.norm(offsets(path), axis=1) == pytest.approx(1.5)
    turned = np.unwrap(azimuths(path), period=360)
    assert turned[-1] - turned[0] == pytest.approx(2 * 360 * 199 / 200)
    assert np.stack([c.project(TARGET) for c in path.cameras.values()]) == pytest.approx(np.tile([320, 240], (200, 1)))


def test_a_spiral_closes():
    around_and_back = np.concatenate([offsets(paths.spiral(dome(), frames=90)), offsets(paths.spiral(dome(), frames=90))[:1]])
    moved = np.linalg.norm(np.diff(around_and_back, axis=0), axis=1)
    assert moved[-1] < 1.05 * moved[:-1].max()


def test_a_spiral_over_an_arc_stays_within_the_arc():
    cone = around([pose for e in (20, 40) for pose in orbit(TARGET, 1.5, e, 8, start_deg=-50, sweep_deg=110)])
    path = paths.spiral(cone, frames=80)
    azimuth = (azimuths(path) + 180) % 360 - 180
    assert azimuth.min() == pytest.approx(-50) and azimuth.max() == pytest.approx(60)
    assert elevations(path).min() >= 20 - 1e-6 and elevations(path).max() <= 40 + 1e-6


@pytest.mark.parametrize("keys", [2, 6, 0])
def test_a_path_through_photographed_views_passes_each_of_them_exactly(keys):
    cameras = dome()
    path = paths.interpolate(cameras, frames=120, keys=keys)
    poses = np.stack([camera.world_from_camera for camera in path.cameras.values()])
    passed = [i for i, c in enumerate(cameras) if np.abs(poses - c.world_from_camera).max(axis=(1, 2)).min() < 1e-12]
    assert len(poses) == 120 and len(passed) == (keys or len(cameras))


def test_a_path_through_views_is_smooth_and_takes_a_short_way():
    metres, radians = steps(paths.interpolate(dome(), frames=300, keys=0))
    assert metres.max() < 4 * np.median(metres) and radians.max() < 4 * np.median(radians)
    apart = np.linalg.norm(np.diff([c.centre for c in dome()], axis=0), axis=1)
    assert metres.sum() < 0.6 * apart.sum()


def test_between_two_turned_views_a_path_turns_evenly_about_one_axis():
    """Of two keys the spline is the geodesic of SO(3) and a straight line."""
    first = Camera.from_fov(look_at((0, -1, 0), (0, 0, 0)), 64, 48, 50)
    second = Camera.from_fov(look_at((1, 0, 0), (0, 0, 0)), 64, 48, 50)
    metres, radians = steps(paths.interpolate([first, second], frames=10, keys=2))
    assert radians == pytest.approx(np.pi / 2 / 9) and metres == pytest.approx(np.sqrt(2) / 9)


def test_views_at_one_place_are_told_apart_by_where_they_look():
    turns = [look_at((0, 0, 1), (np.cos(a), np.sin(a), 1)) for a in np.linspace(0, 2, 5)]
    path = paths.interpolate(around(turns), frames=33, keys=0)
    assert steps(path)[1] == pytest.approx(2 / 32, rel=0.02)


def test_equal_views_are_passed_once():
    camera = dome()[0]
    assert len(paths.interpolate([camera, camera], frames=5, keys=0).cameras) == 1


def test_too_few_frames_are_refused():
    with pytest.raises(ValueError, match="5 frames cannot pass 8 views"):
        paths.interpolate(dome(), frames=5, keys=8)
    for path in (paths.orbit, paths.spiral, paths.interpolate):
        with pytest.raises(ValueError, match="at least one frame"):
            path(dome(), frames=0)


def test_quaternions_return_their_rotation():
    turned = np.stack([pose[:3, :3] for pose in orbit(TARGET, 1, 40, 7)] + [np.eye(3), np.diag([1.0, -1, -1])])
    assert np.stack([paths._rotation(q) for q in paths._quat_wxyz(turned)]) == pytest.approx(turned)


def test_with_even_knots_the_spline_is_catmull_roms():
    """2 x(t) = 2 P1 + (P2 - P0) t + (2 P0 - 5 P1 + 4 P2 - P3) t^2 + (3 P1 - P0 - 3 P2 + P3) t^3."""
    P = np.random.default_rng(0).normal(size=(4, 3))
    for t in (0.0, 0.3, 1.0):
        cubic = 2 * P[1] + (P[2] - P[0]) * t + (2 * P[0] - 5 * P[1] + 4 * P[2] - P[3]) * t**2 + (3 * P[1] - P[0] - 3 * P[2] + P[3]) * t**3
        assert paths._pyramid(paths._lerp, P, np.arange(-1.0, 3.0), t) == pytest.approx(cubic / 2)
