"""Steps: planted feet stay, swinging ones are lifted, and each ends below its hip."""

import numpy as np
import pytest

from robot.arm import Arm
from robot.gait import LIFT, NEAR, slipped, walk


@pytest.fixture(scope="module")
def dog():
    return Arm.load("aliengo_z1")


def travelled(dog, **far):
    """Poses (T, 4, 4) of the trunk that travels for 3 s at an even pace, then stands for one."""
    times = np.linspace(0, 4, 961)
    q = np.repeat(dog.home[None], len(times), axis=0)
    for name, way in far.items():
        q[:, dog.joint_names.index(name)] += way * np.clip(times / 3, 0, 1)
    return times, dog.link_poses(q)[:, dog.link_names.index("trunk")]


def test_planted_feet_do_not_move_and_swinging_ones_are_lifted(dog):
    done = walk(dog.legs, *travelled(dog, trunk_x=0.6))
    still = done.stands[1:] & done.stands[:-1]
    assert np.abs(np.diff(done.feet, axis=0))[still].max() == 0
    assert done.feet[..., 2].max() == pytest.approx(dog.legs.ground + dog.legs.radius + LIFT, abs=1e-4)
    np.testing.assert_allclose(done.feet[done.stands][:, 2], dog.legs.ground + dog.legs.radius, atol=1e-12)
    assert done.steps >= 8 and (done.stands.sum(axis=1) >= 2).all()


@pytest.mark.parametrize("far", [{"trunk_x": -0.5}, {"trunk_y": 0.4}, {"trunk_yaw": 1.2}, {"trunk_x": 0.4, "trunk_yaw": -0.6}])
def test_a_trunk_that_has_travelled_ends_above_its_feet(dog, far):
    times, poses = travelled(dog, **far)
    done = walk(dog.legs, times, poses)
    assert np.linalg.norm(done.feet[-1] - dog.legs.stance(poses[-1]), axis=1).max() <= NEAR + 1e-9
    assert np.abs(np.diff(done.joints, axis=0)).max() / (times[1] - times[0]) < 15.89  # rad/s, the calf's limit


def test_sinking_and_leaning_make_no_step(dog):
    done = walk(dog.legs, *travelled(dog, trunk_height=-0.15, trunk_pitch=0.2, trunk_x=0.03))
    assert done.steps == 0 and np.ptp(done.feet, axis=0).max() == 0
    assert done.joints[-1, 2] < done.joints[0, 2] - 0.5  # the front left knee


def test_slip_is_counted_while_a_foot_stands(dog):
    feet = np.zeros((6, 2, 3))
    feet[3:, 0, 0] = [0.5, 0.5, 0.502]
    feet[2, 0] = np.nan  # it was lifted in between
    assert slipped(feet) == pytest.approx(0.002)
    assert slipped(np.zeros((6, 0, 3))) == 0
