import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from similarities import random_similarity, unscaled

from scene import frame
from scene.camera import Camera, look_at
from scene.frame import gravity
from scene.frame.similarity import jacobian, judged, umeyama, with_uncertainty
from scene.model import Model, ReconstructionFailed


def cameras(count=8):
    angles = np.linspace(0, 5, count)
    eyes = [(0.6 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0.9 + 0.4 * np.sin(3 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.6, 0, 0)), 640, 480, 50) for eye in eyes]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_umeyama_finds_the_similarity_that_made_the_points(seed):
    true = random_similarity(seed)
    points = np.random.default_rng(seed + 1).normal(size=(5, 3))
    found = umeyama(points, true.apply(points))
    assert np.allclose(found.matrix, true.matrix, atol=1e-8)


def test_mirrored_points_are_answered_by_a_rotation_and_never_by_a_mirror():
    points = np.random.default_rng(0).normal(size=(6, 3)) * [1, 0.8, 0.1]
    found = umeyama(points, points * [1, 1, -1])
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_points_on_a_line_give_no_frame():
    line = np.linspace(0, 1, 6)[:, None] * [1.0, 2.0, 3.0]
    with pytest.raises(ReconstructionFailed, match="one line"):
        umeyama(line, line)


def test_a_similarity_moves_points_and_cameras_alike():
    similarity, camera = random_similarity(2), cameras()[0]
    point = np.array([0.5, 0.1, 0.2])
    assert np.allclose(similarity.move(camera).project(similarity.apply(point)), camera.project(point))
    assert similarity.describe()["name"] == "robot base" and similarity.describe()["unit"] == "m"


# Without tags


def test_gravity_is_found_from_upright_cameras_in_any_frame():
    true = random_similarity(3)
    found = gravity.align(SimpleNamespace(cameras=unscaled(true, cameras()), points=np.zeros((0, 3))))
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
    up = gravity.align(SimpleNamespace(cameras=askew, points=points)).rotation[2]
    assert np.degrees(np.arccos(up[2])) < 0.2


def test_cameras_side_by_side_still_have_an_up():
    row = [Camera.from_fov(look_at((x, -2.0, 1.0), (x, 0.0, 0.0)), 64, 48, 50) for x in (0.0, 0.1, 0.2)]
    found = gravity.align(SimpleNamespace(cameras=row, points=np.random.default_rng(0).normal(size=(50, 3))))
    assert np.isfinite(found.matrix).all() and found.rotation[2] @ [0, 0, 1] > 0.8


def test_a_level_frame_looks_along_the_given_direction():
    rotation = gravity.level(np.array([0, 0, 1.0]), cameras()[0], np.array([0, 2.0, 5.0]))
    assert np.allclose(rotation, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])


# How sure a frame is


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_the_jacobian_is_that_of_a_small_similarity(seed):
    rng = np.random.default_rng(seed)
    points, about, true = rng.normal(size=(4, 3)), rng.normal(size=3), random_similarity(seed)
    numeric = [(true.nudged(h, about).apply(points) - true.nudged(-h, about).apply(points)) / 2e-6 for h in 1e-6 * np.eye(7)]
    assert np.allclose(jacobian(true.apply(points), about), np.stack(numeric, axis=-1), atol=1e-6)


def test_the_told_uncertainty_is_the_error_that_noise_makes():
    """Cameras' errors over many draws of noisy points have the root mean square that one draw is told to have."""
    rng, true = np.random.default_rng(0), random_similarity(1)
    places = rng.normal(size=(12, 3)) * [1.0, 0.4, 0.2]
    points = np.linalg.solve(true.matrix, np.c_[places, np.ones(12)].T).T[:, :3]
    seen, errors = unscaled(true, cameras()), []
    for _ in range(400):
        found = umeyama(points, places + rng.normal(0, 1e-3, places.shape))
        errors += [np.linalg.norm(found.move(a).centre - b.centre) for a, b in zip(seen, cameras())]
    J = jacobian(places, places.mean(axis=0)).reshape(-1, 7)
    told = with_uncertainty(true, J, 1e-3, seen, places.mean(axis=0)).uncertainty_mm
    assert told == pytest.approx(1000 * np.sqrt(np.mean(np.square(errors))), rel=0.05)


def test_an_unsure_frame_is_said_and_a_useless_one_refused():
    sure, unsure = judged(random_similarity(0), 4.9), judged(random_similarity(0), 12)
    assert sure.warnings == () and "12 mm" in unsure.warnings[0] and unsure.uncertainty_mm == 12
    for off in (51, 1e9, float("inf"), float("nan")):
        with pytest.raises(ReconstructionFailed, match="rest on"):
            judged(random_similarity(0), off)


# What is found beside the photographs


def model():
    """Eight cameras of a model without scale that know nothing else."""
    true = random_similarity(5)
    seen = tuple(unscaled(true, cameras()))
    points = np.random.default_rng(0).normal(size=(50, 3))
    names = tuple(f"{i:04d}" for i in range(8))
    return true, Model(names, seen, (), points, np.zeros((50, 3), np.uint8), np.ones(50), 8, 0.5, (), Path("none"))


def write(folder, name, content):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(content))


def known(folder, name="poses.json"):
    opengl = [camera.world_from_camera * [1, -1, -1, 1] for camera in cameras()]
    write(folder, name, {"frames": [{"file_path": f"./a/{i:04d}.jpg", "transform_matrix": m.tolist()} for i, m in enumerate(opengl)]})


def test_without_any_file_the_frame_is_arbitrary_and_level(tmp_path):
    found = frame.find(model()[1], tmp_path)
    assert found.frame == "arbitrary" and "none of tags.json, poses.json, arm_poses.json, distance.json" in found.warnings[0]


@pytest.mark.parametrize("name", ["poses.json", "poses/transforms.json"])
def test_known_poses_beside_the_photographs_give_the_frame(tmp_path, name):
    known((tmp_path / name).parent, Path(name).name)
    true, seen = model()
    found = frame.find(seen, tmp_path)
    assert np.allclose(found.matrix, true.matrix, atol=1e-6) and found.frame == "robot base"
    assert json.dumps(found.describe(), allow_nan=False)
    assert frame.find(seen, tmp_path, method="gravity").frame == "arbitrary"


def test_a_transforms_json_among_the_photographs_is_not_taken_for_the_robots_frame(tmp_path):
    known(tmp_path, "transforms.json")
    assert frame.find(model()[1], tmp_path).frame == "arbitrary"
    assert frame.find(model()[1], tmp_path, method="poses", file=tmp_path / "transforms.json").frame == "robot base"


def test_of_several_files_the_first_is_used_and_the_others_are_named(tmp_path):
    known(tmp_path)
    write(tmp_path, "arm_poses.json", {"base_from_flange": {c: m.world_from_camera.tolist() for c, m in zip(model()[1].names, cameras())}})
    found = frame.find(model()[1], tmp_path)
    assert "8 known camera poses" in found.rests_on and "arm_poses.json" in found.warnings[-1]
    assert "poses of the arm" in frame.find(model()[1], tmp_path, method="arm").rests_on
    write(tmp_path, "tags.json", {})
    assert frame.choose(tmp_path)[:2] == ("tags", tmp_path / "tags.json")


def test_a_wish_that_cannot_be_met_says_what_there_is(tmp_path):
    with pytest.raises(ValueError, match="unknown.*auto, tags, poses, arm, distance, gravity"):
        frame.choose(tmp_path, "sextant")
    with pytest.raises(FileNotFoundError, match="needs arm_poses.json"):
        frame.choose(tmp_path, "arm")
    with pytest.raises(ValueError, match="needs scene/frame="):
        frame.choose(tmp_path, "auto", "my.json")
    with pytest.raises(FileNotFoundError, match="no such tag layout"):
        frame.read(tmp_path, method="tags", file=tmp_path / "tags.json")
