"""Legs: closed form against forward kinematics, and reasons where they cannot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot.arm import Arm
from robot.bullet import connect
from robot.inverse import NoSolution
from robot.legs import Legs


@pytest.fixture(scope="module")
def dog():
    return Arm.load("aliengo_z1")


def placed(x=0.0, y=0.0, z=0.0, yaw=0.0, pitch=0.0):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix()
    pose[:3, 3] = x, y, z
    return pose


def test_feet_are_where_the_angles_say_by_forward_kinematics(dog):
    rng, client = np.random.default_rng(0), connect()
    body = dog.spawn(client)
    numbers = {client.getJointInfo(body, k)[12].decode(): k for k in range(client.getNumJoints(body))}
    for _ in range(20):
        q = dog.home + rng.uniform(-1, 1, 11) * [0.5, 0.5, 1, 0, 0.2, *[0] * 6] - [0, 0, 0, rng.uniform(0, 0.15), *[0] * 7]
        trunk = dog.link_poses(q)[0, dog.link_names.index("trunk")]
        feet = dog.legs.stance(trunk) + rng.uniform(-1, 1, (4, 3)) * [0.08, 0.05, 0]
        for joint, value in zip((*dog.joint_indices, *dog.leg_indices), (*q, *dog.legs.angles(trunk[None], feet[None])[0])):
            client.resetJointState(body, joint, value)
        found = [client.getLinkState(body, numbers[foot], computeForwardKinematics=True)[4] for foot in dog.legs.feet]
        np.testing.assert_allclose(found, feet, atol=1e-6)
    client.disconnect()


def test_a_standing_dog_has_the_published_angles(dog):
    angles = dog.walk([0.0], dog.home[None]).joints.reshape(4, 3)
    np.testing.assert_allclose(angles, np.tile([0, 0.67, -1.3], (4, 1)), atol=0.05)


def test_a_lower_trunk_bends_the_knees_and_moves_no_foot(dog):
    poses = np.array([placed(z=z) for z in np.linspace(0.02, -0.16, 10)])
    feet = dog.legs.stance(poses)
    np.testing.assert_allclose(feet, feet[:1].repeat(10, axis=0), atol=1e-12)
    knees = dog.legs.angles(poses, feet)[:, 2::3]
    assert (np.diff(knees, axis=0) < 0).all() and knees[-1].max() < -2.0


def test_a_foot_out_of_reach_and_a_joint_at_its_limit_are_named(dog):
    with pytest.raises(NoSolution, match=r"FL_foot is 0\.\d+ m from its hip, out of its leg's reach"):
        dog.legs.angles(placed(z=0.3)[None], dog.legs.stance(placed())[None])
    with pytest.raises(NoSolution, match="FL_calf_joint for -0.4"):
        dog.legs.angles(placed(z=0.115)[None], dog.legs.stance(placed(z=0.115))[None])


def test_feet_that_are_none_are_said(dog):
    with pytest.raises(ValueError, match="no foot 'paw'"):
        Legs.from_urdf(dog.description, ["paw"], -0.4)
    with pytest.raises(ValueError, match="a hip, a thigh and a calf joint"):
        Legs.from_urdf(dog.description, ["link06"], -0.4)
