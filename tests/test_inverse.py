"""Inverse kinematics along paths: how the hand is turned, which branch is taken, and what is said where there is none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot.arm import Arm, NoSolution, Tool
from robot.bullet import connect
from robot.collision import CollisionModel
from robot.inverse import branches, choose, path_poses
from robot.kinematics import POINTED, POSE, POSITION

S = np.linspace(0, 1, 200)[:, None]


@pytest.fixture(scope="module", params=["panda", "z1"])
def arm(request):
    return Arm.load(request.param)


@pytest.fixture(scope="module")
def panda():
    return Arm.load("panda")


def bow(arm, length=0.2, lift=0.05):
    start = arm.fk(arm.home)[:3, 3]
    return start + S * [0, length, 0] + lift * np.sin(np.pi * S) * [0, 0, 1]


def axis(arm, path):
    return arm.fk(path)[:, :3, 2]


def assert_follows(arm, path, points, start=None):
    assert np.linalg.norm(arm.fk(path)[:, :3, 3] - points, axis=1).max() < 1e-3
    assert np.abs(np.diff(path, axis=0)).max() < 0.2 and arm.within_limits(path).all()
    if start is not None:
        np.testing.assert_allclose(path[0], start, atol=1e-2)


def test_a_free_hand_follows_points(arm):
    assert_follows(arm, arm.along(bow(arm), start=arm.home), bow(arm), arm.home)


def test_a_kept_hand_stays_turned_as_it_is(arm):
    R = arm.fk(arm.home)[:3, :3]
    path = arm.along(bow(arm), Tool("kept", rotation=R), start=arm.home)
    assert_follows(arm, path, bow(arm), arm.home)
    np.testing.assert_allclose(arm.fk(path)[:, :3, :3], np.tile(R, (200, 1, 1)), atol=1e-2)


def test_a_pointed_hand_may_turn_about_its_axis_only(arm):
    z = arm.fk(arm.home)[:3, 2]
    path = arm.along(bow(arm), Tool("pointed", axis=2 * z), start=arm.home)
    assert_follows(arm, path, bow(arm), arm.home)
    assert np.arccos(np.clip(axis(arm, path) @ z, -1, 1)).max() < 1e-2


def test_a_hand_within_a_tolerance_is_turned_no_farther(arm):
    z = arm.fk(arm.home)[:3, 2]
    strict, loose = (arm.along(bow(arm), Tool("pointed", axis=z, tolerance=a), start=arm.home) for a in (0.0, 0.2))
    assert np.arccos(np.clip(axis(arm, loose) @ z, -1, 1)).max() < 0.2 + 1e-2
    assert np.abs(np.diff(loose, axis=0)).sum() <= np.abs(np.diff(strict, axis=0)).sum() + 0.2


def test_a_hand_points_along_the_tangent():
    arm = Arm.load("z1")
    points = arm.fk(arm.home)[:3, 3] + S * [0.08, 0.03, 0.0]
    path = arm.along(points, Tool("tangent"))
    ahead = np.gradient(points, axis=0)
    assert_follows(arm, path, points)
    assert np.arccos(np.clip((axis(arm, path) * ahead).sum(axis=1) / np.linalg.norm(ahead, axis=1), -1, 1)).max() < 1e-2


def test_tools_are_told_apart_and_unknown_ones_refused():
    with pytest.raises(ValueError, match="free, kept, pointed, tangent, not 'held'"):
        Tool("held")
    with pytest.raises(ValueError, match="pointed needs its axis"):
        Tool("pointed")
    with pytest.raises(ValueError, match="tolerance"):
        Tool("tangent", tolerance=4.0)
    with pytest.raises(ValueError, match="no direction"):
        Tool("tangent").poses(np.zeros((5, 3)))
    assert [Tool("kept", rotation=np.eye(3)).poses(np.eye(3))[1], Tool("tangent").poses(np.eye(3))[1]] == [POSE, POINTED]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rows", [POSE, POSITION])
def test_a_path_that_some_arm_has_gone_is_found_where_the_first_branch_may_end(arm, rows, seed):
    ends = arm.random(3, 100 + seed)
    poses = arm.fk((1 - S) ** 2 * ends[0] + 2 * S * (1 - S) * ends[1] + S**2 * ends[2])
    assert_follows(arm, choose(arm, poses, rows), poses[:, :3, 3])


def test_the_best_branch_succeeds_where_the_nearest_one_fails(panda):
    found = first = 0
    for seed in range(6):
        ends = panda.random(3, 100 + seed)
        poses = panda.fk((1 - S) ** 2 * ends[0] + 2 * S * (1 - S) * ends[1] + S**2 * ends[2])
        choose(panda, poses, POSE)
        found += 1
        try:
            panda.follow(poses, start=panda.ik(poses[0]))
            first += 1
        except NoSolution:
            pass
    assert found == 6 and first < 6


def test_branches_are_different_postures_of_one_pose(arm):
    pose = arm.fk(arm.home)
    found = branches(arm, pose, POSE, 0.0, 0)
    assert len(found) >= (8 if arm.name == "panda" else 1)
    np.testing.assert_allclose(arm.fk(np.array(found)), np.tile(pose, (len(found), 1, 1)), atol=1e-3)


def test_the_same_seed_gives_the_same_branch(panda):
    np.testing.assert_array_equal(panda.along(bow(panda), seed=3), panda.along(bow(panda), seed=3))


def test_a_path_out_of_reach_names_its_waypoint_and_comes_near(panda):
    points = np.linspace(panda.fk(panda.home)[:3, 3], [2, 0, 0.5], 100)
    with pytest.raises(NoSolution, match="of 100 of the whole path") as raised:
        panda.along(points, start=panda.home)
    reached = panda.fk(raised.value.posture)[:3, 3]
    assert 20 < raised.value.waypoint < 90 and np.linalg.norm(reached - points[raised.value.waypoint]) < 0.05


def test_a_path_that_begins_out_of_reach_is_refused(panda):
    with pytest.raises(NoSolution, match="first waypoint"):
        panda.along(np.full((5, 3), 3.0))


def test_half_a_turn_of_the_axis_is_undone(panda):
    pose, _ = Tool("pointed", axis=-panda.fk(panda.home)[:3, 2]).poses(panda.fk(panda.home)[None, :3, 3])
    (q,) = branches(panda, pose[0], POINTED, 0.0, 0)[:1]
    np.testing.assert_allclose(panda.fk(q)[:3, 2], pose[0, :3, 2], atol=1e-2)


def test_a_path_of_the_wrong_shape_is_refused():
    for wrong in (np.zeros((3, 2)), np.zeros((0, 3)), np.full((2, 3), np.nan)):
        with pytest.raises(ValueError, match="a path"):
            path_poses(wrong)


def test_forward_kinematics_of_the_z1_is_the_published_geometry():
    arm = Arm.load("z1")
    np.testing.assert_allclose(arm.fk(np.zeros(6))[:3, 3], [-0.35 + 0.218 + 0.07 + 0.0492 + 0.2, 0, 0.0585 + 0.045 + 0.057], atol=1e-9)
    np.testing.assert_allclose(arm.fk(arm.home)[:3, 2], Rotation.from_euler("y", -0.04).apply([1, 0, 0]), atol=1e-9)
    assert arm.gripper.joints == ("jointGripper",) and arm.gripper.closed == 0 and arm.gripper.open < 0


def test_the_jacobian_of_each_arm_is_the_derivative_of_its_pose(arm):
    q, h = arm.random(1, 7)[0], 1e-6
    J = arm.jacobian(q)
    for j, step in enumerate(h * np.eye(len(q))):
        before, after = arm.fk(q - step), arm.fk(q + step)
        turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
        np.testing.assert_allclose(J[:, j], np.append((after - before)[:3, 3], turn) / (2 * h), atol=1e-7)


def test_pybullet_has_the_z1_where_its_kinematics_have_it():
    arm, client = Arm.load("z1"), connect()
    body = arm.spawn(client)
    number = {client.getJointInfo(body, i)[12].decode(): i for i in range(client.getNumJoints(body))}
    for joint, value in zip(arm.joint_indices, arm.home + 0.1):
        client.resetJointState(body, joint, value)
    for name, pose in zip(arm.link_names, arm.link_poses(arm.home + 0.1)[0]):
        if name in number:
            at = client.getLinkState(body, number[name], computeForwardKinematics=True)[4]
            np.testing.assert_allclose(pose[:3, 3], at, atol=1e-5)
    masses = sum(client.getDynamicsInfo(body, i)[0] for i in range(-1, client.getNumJoints(body)))
    client.disconnect()
    assert masses == pytest.approx(4.749, abs=2e-3)  # the published ones, without the fixed base


def test_the_z1_is_clear_of_itself_at_home_and_folds_into_itself():
    model = CollisionModel(Arm.load("z1"))
    assert model.clearance(model.arm.home) > 0.01
    assert (model.clearance(model.arm.random(200, 0)) < 0).mean() < 0.3
