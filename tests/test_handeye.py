"""A camera somewhere on the hand: arm poses give back both the similarity and where the camera sits."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from similarities import random_similarity, unscaled

from scene.camera import Camera, look_at
from scene.frame import handeye
from scene.model import ReconstructionFailed


def rigid(rotvec, translation):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), translation
    return pose


FLANGE_FROM_CAMERA = rigid([0.2, -0.3, 1.6], [0.05, -0.03, 0.08])


def cameras(count=30, seed=0):
    """Views of the table as an arm reaches them: from 40 to 100 cm, not all aimed at its middle."""
    rng = np.random.default_rng(seed)
    eyes = [(0.6, 0, 0) + rng.uniform(0.4, 1.0) * np.array([np.cos(a) * 0.8, np.sin(a) * 0.8, 0.6]) for a in rng.uniform(0, 6, count)]
    return [Camera.from_fov(look_at(eye, rng.normal((0.6, 0, 0), 0.15)), 640, 480, 50) for eye in eyes]


def noisy(pose, rng, mm, degrees):
    return pose @ rigid(rng.normal(0, np.radians(degrees), 3), rng.normal(0, mm / 1000, 3))


def scene(true, known, seed=0, mm=0.0, degrees=0.0):
    """(names, model_from_camera, base_from_flange with noise, the model's cameras)."""
    rng = np.random.default_rng(seed)
    seen = unscaled(true, known)
    flange = np.array([noisy(c.world_from_camera @ np.linalg.inv(FLANGE_FROM_CAMERA), rng, mm, degrees) for c in known])
    return [f"{i:04d}" for i in range(len(known))], np.array([c.world_from_camera for c in seen]), flange, seen


def errors_mm(found, true, seen):
    return np.array([1000 * np.linalg.norm(found.move(c).centre - true.move(c).centre) for c in seen])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_the_closed_form_is_exact_on_exact_poses(seed):
    true = random_similarity(seed)
    _, model, flange, _ = scene(true, cameras(5, seed))
    found, X = handeye.closed_form(model, flange)
    assert np.allclose(found.matrix, true.matrix, atol=1e-6 * true.scale) and np.allclose(X, FLANGE_FROM_CAMERA, atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_exact_poses_return_the_frame_and_the_cameras_place_on_the_hand(seed):
    true = random_similarity(seed)
    found = handeye.fit_frame(*scene(true, cameras(12, seed)))
    assert np.allclose(found.matrix, true.matrix, atol=1e-5 * true.scale)
    assert np.allclose(found.extra["flange_from_camera"], FLANGE_FROM_CAMERA, atol=1e-5)
    assert found.residual_mm < 1e-2 and not found.warnings


@pytest.mark.parametrize("seed", range(8))
def test_poses_off_by_a_millimetre_and_a_tenth_of_a_degree_leave_the_cameras_within_five_millimetres(seed):
    true = random_similarity(seed)
    names, model, flange, seen = scene(true, cameras(seed=seed), seed, 1.0, 0.1)
    found = handeye.fit_frame(names, model, flange, seen)
    assert errors_mm(found, true, seen).max() < 5
    assert 1 < found.residual_mm < 3 and len(found.used) == len(names)


def test_the_told_uncertainty_is_the_error_that_noise_makes():
    true, squares, told = random_similarity(1), [], []
    for seed in range(25):
        names, model, flange, seen = scene(true, cameras(), seed, 1.0, 0.1)
        found = handeye.fit_frame(names, model, flange, seen)
        squares.append(np.mean(errors_mm(found, true, seen) ** 2))
        told.append(found.uncertainty_mm)
    assert np.mean(told) == pytest.approx(np.sqrt(np.mean(squares)), rel=0.35)


@pytest.mark.parametrize("wrong", [[7], [0, 3, 4, 11, 12, 13, 20, 29]])
def test_wrong_poses_are_left_out_and_named(wrong):
    true = random_similarity(2)
    names, model, flange, seen = scene(true, cameras(), 0, 1.0, 0.1)
    rng = np.random.default_rng(1)
    for i in wrong:
        flange[i] = flange[i] @ rigid(rng.normal(0, 0.1, 3), rng.normal(0, 0.1, 3))
    found = handeye.fit_frame(names, model, flange, seen)
    assert set(names) - set(found.used) == {names[i] for i in wrong}
    assert all(names[i] in found.warnings[0] for i in wrong) and errors_mm(found, true, seen).max() < 6


def test_a_pose_that_is_only_turned_wrongly_is_left_out_too():
    true = random_similarity(2)
    names, model, flange, seen = scene(true, cameras(), 0, 0.3, 0.03)
    flange[5] = flange[5] @ FLANGE_FROM_CAMERA @ rigid([0, 0, 0.2], [0, 0, 0]) @ np.linalg.inv(FLANGE_FROM_CAMERA)
    assert set(names) - set(handeye.fit_frame(names, model, flange, seen).used) == {names[5]}


# Motions that leave something open


def with_flange_poses(flange, seed=3):
    true = random_similarity(seed)
    known = [Camera.from_fov(pose @ FLANGE_FROM_CAMERA, 640, 480, 50) for pose in flange]
    return scene(true, known, 0, 0.5, 0.05)


def test_a_hand_that_never_turns_is_refused():
    places = np.random.default_rng(0).normal(size=(12, 3)) * 0.3
    with pytest.raises(ReconstructionFailed, match="hardly turned.*tilt"):
        handeye.fit_frame(*with_flange_poses([rigid([0.1, 0.2, 0.3], p) for p in places]))


def test_a_hand_that_turns_about_one_axis_only_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ReconstructionFailed, match="one axis only"):
        handeye.fit_frame(*with_flange_poses([rigid([0, 0, a], rng.normal(size=3) * 0.3) for a in np.linspace(-1, 1, 12)]))


def test_a_hand_that_turns_on_the_spot_is_refused():
    turns = np.random.default_rng(0).normal(size=(12, 3)) * 0.4
    with pytest.raises(ReconstructionFailed, match="move the hand|leaves the frame open|may be off|do not fit"):
        handeye.fit_frame(*with_flange_poses([rigid(turn, [0.5, 0, 0.5]) for turn in turns]))


def test_small_tilts_are_said_to_be_unsure():
    rng = np.random.default_rng(0)
    names, model, flange, seen = with_flange_poses([rigid(rng.normal(size=3) * 0.15, rng.normal(size=3) * 0.15) for _ in range(12)])
    found = handeye.fit_frame(names, model, flange, seen)
    assert found.uncertainty_mm > 1
    assert errors_mm(found, random_similarity(3), seen).max() < 5 * found.uncertainty_mm


def test_too_few_poses_are_refused_and_few_are_said():
    names, model, flange, seen = scene(random_similarity(0), cameras())
    with pytest.raises(ReconstructionFailed, match="3 arm poses are too few"):
        handeye.fit_frame(names[:3], model[:3], flange[:3], seen[:3])
    assert "only 6 arm poses" in handeye.fit_frame(names[:6], model[:6], flange[:6], seen[:6]).warnings[0]


def test_poses_of_other_photographs_or_the_other_way_round_are_refused():
    names, model, flange, seen = scene(random_similarity(0), cameras(), 0, 1.0, 0.1)
    with pytest.raises(ReconstructionFailed, match="do not fit the photographs.*not its inverse"):
        handeye.fit_frame(names, model, np.linalg.inv(flange), seen)
    with pytest.raises(ReconstructionFailed, match="do not fit|no scale"):
        handeye.fit_frame(names, model, np.random.default_rng(0).permutation(flange), seen)


# The file


def test_the_file_is_read_by_the_photographs_names(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"base_from_flange": {"IMG 1.JPG": FLANGE_FROM_CAMERA.tolist()}}))
    assert np.array_equal(handeye.load(tmp_path / "a.json")["IMG 1"], FLANGE_FROM_CAMERA)


@pytest.mark.parametrize(("content", "message"), [
    ("{}", "missing base_from_flange"), ("[]", "a.json"), ("{", "a.json"), ('{"base_from_flange": {"x": [[1, 0]]}}', "x: the pose"),
    ('{"base_from_flange": {"x": [[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]}}', "orthonormal"), ('{"base_from_flange": 3}', "a.json"),
])  # fmt: skip
def test_a_broken_file_says_what_is_wrong(tmp_path, content, message):
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ValueError, match=message):
        handeye.load(tmp_path / "a.json")
    with pytest.raises(FileNotFoundError, match="no such file of arm poses"):
        handeye.load(tmp_path / "b.json")
