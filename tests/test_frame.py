import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene import frame
from scene.camera import Camera, look_at
from scene.colmap import ReconstructionFailed
from scene.frame import Similarity


def cameras(count=8):
    angles = np.linspace(0, 5, count)
    eyes = [(0.6 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0.9 + 0.1 * np.sin(3 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.6, 0, 0)), 640, 480, 50) for eye in eyes]


def random_similarity(seed):
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    return Similarity(float(rng.uniform(0.1, 5)), rotation, rng.normal(size=3))


def unscaled(similarity, to_move):
    """The cameras in a model's frame that ``similarity`` brings to the robot's base."""
    return [camera.moved(np.linalg.inv(similarity.matrix)) for camera in to_move]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_umeyama_finds_the_similarity_that_made_the_points(seed):
    true = random_similarity(seed)
    points = np.random.default_rng(seed + 1).normal(size=(5, 3))
    found = frame.umeyama(points, true.apply(points))
    assert np.allclose(found.matrix, true.matrix, atol=1e-8)


def test_points_on_a_line_give_no_frame():
    line = np.linspace(0, 1, 6)[:, None] * [1.0, 2.0, 3.0]
    with pytest.raises(ReconstructionFailed, match="one line"):
        frame.umeyama(line, line)


def test_a_similarity_moves_points_and_cameras_alike():
    similarity, camera = random_similarity(2), cameras()[0]
    point = np.array([0.5, 0.1, 0.2])
    assert np.allclose(similarity.move(camera).project(similarity.apply(point)), camera.project(point))
    assert similarity.describe()["name"] == "robot base" and similarity.describe()["unit"] == "m"


# Without tags


def test_gravity_is_found_from_upright_cameras_in_any_frame():
    true = random_similarity(3)
    found = frame.gravity_frame(unscaled(true, cameras()), np.zeros((0, 3)))
    up = true.rotation @ found.rotation.T @ [0, 0, 1]
    assert up == pytest.approx([0, 0, 1], abs=1e-6)
    distances = [np.linalg.norm(found.move(c).centre) for c in unscaled(true, cameras())]
    assert np.median(distances) == pytest.approx(1)
    assert found.describe() == {"name": "arbitrary", "unit": "arbitrary"}


def test_the_ground_corrects_cameras_that_were_held_askew():
    rng = np.random.default_rng(0)
    ground = np.concatenate([rng.uniform(-1, 1, (200, 2)), rng.normal(0, 1e-3, (200, 1))], axis=1)
    points = np.concatenate([ground, rng.uniform(-0.3, 0.3, (100, 3)) + [0, 0, 0.3]])
    roll = np.array([[np.cos(0.1), -np.sin(0.1), 0, 0], [np.sin(0.1), np.cos(0.1), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    askew = [Camera(c.K, c.world_from_camera @ roll, c.width, c.height) for c in cameras()]
    up = frame.gravity_frame(askew, points).rotation[2]
    assert np.degrees(np.arccos(up[2])) < 0.2


def test_cameras_side_by_side_still_have_an_up():
    row = [Camera.from_fov(look_at((x, -2.0, 1.0), (x, 0.0, 0.0)), 64, 48, 50) for x in (0.0, 0.1, 0.2)]
    found = frame.gravity_frame(row, np.random.default_rng(0).normal(size=(50, 3)))
    assert np.isfinite(found.matrix).all() and found.rotation[2] @ [0, 0, 1] > 0.8
