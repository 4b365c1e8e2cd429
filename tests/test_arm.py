"""Kinematics: equal to PyBullet's, Jacobian equal to finite differences, inverse kinematics undone by forward
kinematics."""

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from robot.arm import Arm, NoSolution
from robot.collision import CollisionModel
from robot.kinematics import rotation_vector
from robot.urdf import Urdf


@pytest.fixture(scope="module")
def arm():
    return Arm.load("panda")


@pytest.fixture
def client():
    client = BulletClient(pybullet.DIRECT)
    yield client
    client.disconnect()


def test_every_link_is_where_pybullet_has_it(arm, client):
    body = arm.spawn(client)
    number = {client.getJointInfo(body, i)[12].decode(): i for i in range(client.getNumJoints(body))}
    for q in arm.random(20, seed=3):
        for joint, value in zip(arm.joint_indices, q):
            client.resetJointState(body, joint, value)
        for name, pose in zip(arm.link_names, arm.link_poses(q)[0]):
            if name in number:
                position, quat_xyzw = client.getLinkState(body, number[name], computeForwardKinematics=True)[4:6]
                np.testing.assert_allclose(pose[:3, 3], position, atol=1e-5)
                np.testing.assert_allclose(pose[:3, :3], Rotation.from_quat(quat_xyzw).as_matrix(), atol=1e-5)


def test_the_arm_is_spawned_at_home_with_open_fingers(arm, client):
    body = arm.spawn(client)
    assert client.getBasePositionAndOrientation(body)[0] == pytest.approx((0, 0, 0.05), abs=0.06)  # its centre of mass
    state = [client.getJointState(body, j)[0] for j in (*arm.joint_indices, *arm.gripper_indices)]
    np.testing.assert_allclose(state, [*arm.home, 0.04, 0.04])


def test_the_tip_at_home_points_down_in_front_of_the_base(arm):
    pose = arm.fk(arm.home)
    np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-3)
    assert 0.2 < pose[0, 3] < 0.6 and abs(pose[1, 3]) < 1e-3 and pose[2, 3] > 0.3


def test_a_batch_gives_what_each_gives(arm):
    q = arm.random(5, seed=0)
    np.testing.assert_allclose(arm.fk(q), [arm.fk(each) for each in q])
    np.testing.assert_allclose(arm.fk(q), arm.link_poses(q)[:, arm.link_names.index(arm.tip_link)])


@pytest.mark.parametrize("seed", range(5))
def test_the_jacobian_is_the_derivative_of_the_pose(arm, seed):
    q, h = arm.random(1, seed)[0], 1e-6
    J = arm.jacobian(q)
    for j in range(len(q)):
        before, after = arm.fk(q - h * np.eye(len(q))[j]), arm.fk(q + h * np.eye(len(q))[j])
        np.testing.assert_allclose(J[:3, j], (after - before)[:3, 3] / (2 * h), atol=1e-7)
        np.testing.assert_allclose(
            J[3:, j], Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / (2 * h), atol=1e-7
        )


angles = st.one_of(st.floats(0, np.pi), st.floats(np.pi - 1e-5, np.pi), st.floats(0, 1e-6))


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1), angles)
@settings(deadline=None, max_examples=100)
def test_the_rotation_vector_undoes_the_exponential(axis, angle):
    R = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    np.testing.assert_allclose(Rotation.from_rotvec(rotation_vector(R)).as_matrix(), R, atol=1e-9)


def test_forward_kinematics_of_inverse_kinematics_is_the_target_for_99_of_100_poses(arm):
    targets, solved = arm.fk(arm.random(300, seed=1)), 0
    for target in targets:
        try:
            q = arm.ik(target)
        except NoSolution:
            continue
        pose = arm.fk(q)
        turned = Rotation.from_matrix(pose[:3, :3].T @ target[:3, :3]).magnitude()
        assert np.linalg.norm(pose[:3, 3] - target[:3, 3]) < 1e-3 and turned < 1e-2
        assert (q >= arm.lower).all() and (q <= arm.upper).all()
        solved += 1
    assert solved >= 297


def test_a_position_alone_can_be_asked_for(arm):
    target = np.eye(4)
    target[:3, 3] = [0.5, -0.3, 0.4]
    q = arm.ik(target, position_only=True)
    np.testing.assert_allclose(arm.fk(q)[:3, 3], target[:3, 3], atol=1e-3)


def test_comfort_moves_a_redundant_arm_towards_home_and_keeps_the_pose(arm):
    q0 = np.array([0.8, -0.3, -0.9, -2.0, 0.5, 1.9, 0.2])
    relaxed, as_found = arm.ik(arm.fk(q0), start=q0), arm.ik(arm.fk(q0), start=q0, comfort=0)
    assert np.linalg.norm(relaxed - arm.home) < np.linalg.norm(as_found - arm.home) - 0.1
    np.testing.assert_allclose(arm.fk(relaxed), arm.fk(as_found), atol=1e-3)


def test_the_same_question_has_the_same_answer(arm):
    target = arm.fk(arm.random(1, seed=8)[0])
    np.testing.assert_array_equal(arm.ik(target, seed=4), arm.ik(target, seed=4))


def test_out_of_reach_is_refused_with_the_distance(arm):
    target = arm.fk(arm.home)
    target[:3, 3] = [2, 0, 0.5]
    with pytest.raises(NoSolution, match=r"stops \d+\.\d mm and .* degrees short"):
        arm.ik(target)


def test_a_pose_barred_by_a_limit_names_the_limit():
    arm = Arm.load("panda")
    free = arm.fk(arm.home)
    barred = Arm.from_urdf(
        "pybullet_data:franka_panda/panda.urdf",
        tip_link="panda_grasptarget",
        home=[0.5, -0.785, 0, -2.356, 0, 1.571, 0.785],
        lower=[0.4, -1.7, 0, -3, 0, 0, 0],
        upper=[0.6, 1.7, 1e-9, -0.1, 1e-9, 3.7, 1],
    )
    free[:3, 3] = [0.3, -0.4, 0.5]
    with pytest.raises(NoSolution, match="panda_joint1 at its lower limit"):
        barred.ik(free)


def test_a_path_is_followed_continuously_and_exactly(arm):
    s = np.linspace(0, 1, 200)[:, None]
    start = arm.fk(arm.home)[:3, 3]
    points = start + s * (np.array([0.6, 0.3, 0.3]) - start) + 0.1 * np.sin(np.pi * s) * [0, 0, 1]
    path = arm.follow(points)
    assert np.linalg.norm(arm.fk(path)[:, :3, 3] - points, axis=1).max() < 1e-3
    assert np.abs(np.diff(path, axis=0)).max() < 0.2 and arm.within_limits(path).all()
    np.testing.assert_allclose(path[0], arm.home, atol=1e-3)


def test_a_path_of_poses_keeps_the_orientation(arm):
    poses = np.repeat(arm.fk(arm.home)[None], 100, axis=0)
    poses[:, 1, 3] += np.linspace(0, 0.3, 100)
    np.testing.assert_allclose(arm.fk(arm.follow(poses)), poses, atol=1e-3)


def test_a_path_out_of_reach_says_at_which_waypoint(arm):
    points = np.linspace(arm.fk(arm.home)[:3, 3], [2, 0, 0.5], 100)
    with pytest.raises(NoSolution, match=r"waypoint \d+ of 100") as raised:
        arm.follow(points)
    assert 20 < raised.value.waypoint < 90 and len(raised.value.path) == raised.value.waypoint


def test_a_jump_is_not_a_path(arm):
    points = np.stack([arm.fk(arm.home)[:3, 3], [-0.3, 0.4, 0.5]])
    with pytest.raises(NoSolution, match="jump"):
        arm.follow(points)


def test_joint_values_of_the_wrong_length_are_refused(arm):
    with pytest.raises(ValueError, match="7 finite joint values"):
        arm.fk(np.zeros(9))


def test_an_unknown_arm_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match="no arm named 'pandas'; there are .*panda"):
        Arm.load("pandas")


LINK = '<link name="{}"/>'
HINGE = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 0 1"/>'
    '<origin xyz="1 0 0"/><limit lower="{3}" upper="1" velocity="2" effort="1"/></joint>'
)


def write_urdf(folder, *parts):
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return path


def test_any_urdf_is_an_arm_with_its_own_limits(tmp_path):
    path = write_urdf(
        tmp_path, *map(LINK.format, "abc"), HINGE.format("j", "a", "b", -1), HINGE.format("k", "b", "c", -1)
    )
    arm = Arm.load(path)
    assert arm.joint_names == ("j", "k") and arm.tip_link == "c"
    np.testing.assert_allclose(arm.velocity, 2)
    np.testing.assert_allclose(arm.fk([np.pi / 6, 0])[:3, 3], [1 + np.cos(np.pi / 6), 0.5, 0], atol=1e-12)


@pytest.mark.parametrize(
    "parts, message",
    [
        ((LINK.format("a"), LINK.format("b"), HINGE.format("j", "a", "b", "nan")), "arm.urdf: lower of j: 'nan' should be 1 finite number$"),
        ((LINK.format("a"), HINGE.format("j", "a", "b", -1)), "names the link b"),
        ((LINK.format("a"), LINK.format("b")), "one tree"),
        ((LINK.format("a"),), "no joint moves"),
        (("<oops",), "not readable"),
        (('<link name="a"><collision><geometry><box size="1 -1 1"/></geometry></collision></link>',), "not positive"),
    ],
)
def test_a_bad_urdf_is_refused_with_its_fault(tmp_path, parts, message):
    with pytest.raises(ValueError, match=message):
        Arm.load(write_urdf(tmp_path, *parts))


def test_a_missing_urdf_tip_or_mesh_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="no URDF"):
        Arm.load(tmp_path / "none.urdf")
    path = write_urdf(tmp_path, *map(LINK.format, "ab"), HINGE.format("j", "a", "b", -1))
    with pytest.raises(ValueError, match="no link 'hand'; its links are a, b"):
        Arm.from_urdf(path, tip_link="hand")
    mesh = '<link name="a"><collision><geometry><mesh filename="package://gone.obj"/></geometry></collision></link>'
    with pytest.raises(FileNotFoundError, match="gone.obj"):
        Urdf.load(write_urdf(tmp_path, mesh))


def test_an_arm_of_ones_own_is_a_short_file(tmp_path):
    write_urdf(tmp_path, *map(LINK.format, "abc"), HINGE.format("j", "a", "b", -1), HINGE.format("k", "b", "c", -1))
    file = tmp_path / "mine.yaml"
    file.write_text("urdf: arm.urdf\ntip_link: b\nhome: [0.5]\ngripper: {joints: [k], open: [0.3], closed: -0.1}\n")
    arm = Arm.load(file)
    assert arm.joint_names == ("j",) and arm.tip_link == "b" and arm.home == 0.5
    assert arm.gripper.joints == ("k",) and arm.gripper.open == 0.3 and arm.gripper.closed == -0.1


@pytest.mark.parametrize(
    "text, message",
    [
        ("urdf: arm.urdf\ntip: b\n", "unknown tip; its keys are urdf, tip_link"),
        ("tip_link: b\n", "no urdf"),
        ("[", "not YAML"),
        ("urdf\n", "must hold an arm's settings"),
        ("urdf: arm.urdf\ntip_link: hand\n", "no link 'hand'; its links are a, b, c"),
        ("urdf: arm.urdf\nlower: [.nan, 0]\n", "lower must be 2 numbers"),
        ("urdf: arm.urdf\nhome: ['.nan', 0]\n", "home must be 2 numbers, one for each joint; got \\['.nan', 0\\]"),
        ("urdf: arm.urdf\nhome: [[1], 0]\n", "home must be 2 numbers"),
        ("urdf: arm.urdf\ntip_link: b\ngripper: {joints: [x], open: [0], closed: [0]}\n", "gripper's joint x is none of k"),
        ("urdf: arm.urdf\ntip_link: b\ngripper: {joints: [k], open: [0]}\n", "has joints, open and closed"),
        ("urdf: arm.urdf\ntip_link: b\ngripper: {joints: [k], open: [], closed: [0]}\n", "gripper's open must be 1 numbers"),
    ],
)
def test_a_bad_file_of_an_arm_is_refused_with_its_fault(tmp_path, text, message):
    write_urdf(tmp_path, *map(LINK.format, "abc"), HINGE.format("j", "a", "b", -1), HINGE.format("k", "b", "c", -1))
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(ValueError, match=message):
        Arm.load(tmp_path / "mine.yaml")
    with pytest.raises(FileNotFoundError, match="no arm file"):
        Arm.load(tmp_path / "yours.yaml")


def test_an_unreadable_mesh_is_said_before_anything_is_planned(tmp_path):
    (tmp_path / "link.stl").write_bytes(b"solid nonsense")
    mesh = '<link name="a"><collision><geometry><mesh filename="link.stl"/></geometry></collision></link>'
    path = write_urdf(tmp_path, mesh, LINK.format("b"), HINGE.format("j", "a", "b", -1))
    with pytest.raises(ValueError, match="mesh"):
        CollisionModel(Arm.load(path))
