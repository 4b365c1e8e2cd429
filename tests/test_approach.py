"""The way to where a motion begins: clear all along, the same for the same seed, and refused where there is none."""

from types import SimpleNamespace

import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient

from robot.approach import DENSE, approach
from robot.arm import Arm, NoSolution
from robot.collision import CollisionModel
from robot.planner import plan
from robot.timing import motion_spline
from teach.basis import SquaredExponential
from teach.trajectory import Skill, TrajectoryDistribution


@pytest.fixture(scope="module")
def arm():
    return Arm.load("panda")


@pytest.fixture(scope="module")
def world():
    """A wall beside the home posture, which the straight way to the other side would run through."""
    client = BulletClient(pybullet.DIRECT)
    shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.25, 0.02, 0.3])
    yield SimpleNamespace(client=client, bodies={"wall": client.createMultiBody(0, shape, -1, [0.5, 0.25, 0.3])})
    client.disconnect()


BEHIND = [1.7, 0, 0, 0, 0, 0, 0]


def skill(at, to):
    s, basis = np.linspace(0, 1, 60), SquaredExponential(10, 30.0)
    W = np.linalg.lstsq(basis(s), np.array(at) + s[:, None] * np.subtract(to, at), rcond=None)[0]
    return Skill(TrajectoryDistribution(basis, W, 1e-4 * np.eye(30)), 2.0)


def test_the_way_around_a_wall_is_clear_and_repeatable(arm, world):
    model, end = CollisionModel(arm, world), arm.home + BEHIND
    assert model.sweep(np.stack([arm.home, end])).clearance[0] < 0
    path = approach(model, arm.home, end, 0.01, seed=0)
    assert model.sweep(path, required=0.009).clearance.min() >= 0.009
    np.testing.assert_array_equal(path[[0, -1]], [arm.home, end])
    assert np.abs(np.diff(path, axis=0)).max() <= DENSE + 1e-9 and arm.within_limits(path).all()
    np.testing.assert_array_equal(path, approach(model, arm.home, end, 0.01, seed=0))


def test_where_nothing_is_in_the_way_it_is_straight(arm):
    end = arm.home + [0.3, 0.1, 0, 0, 0, 0, 0.2]
    path = approach(CollisionModel(arm), arm.home, end, 0.01, seed=0)
    np.testing.assert_allclose(path, arm.home + np.linspace(0, 1, len(path))[:, None] * (end - arm.home), atol=1e-12)


def test_a_hand_elsewhere_goes_to_where_the_motion_begins_first(arm, world):
    begin = arm.fk(arm.home + BEHIND)[:3, 3]
    taught = skill(begin, begin + [0.05, 0.1, 0.1])
    planned = plan(taught, arm, world, samples=3, waypoints=50)
    assert planned.feasible and 0 < planned.begins < planned.times[-1] - 1.9
    np.testing.assert_array_equal(planned.joints[0], arm.home)
    there = planned.tip[np.abs(planned.times - planned.begins).argmin()]
    np.testing.assert_allclose(there, begin, atol=0.02)
    model, motion = CollisionModel(arm, world), motion_spline(planned.times, planned.joints)
    t = np.linspace(0, planned.times[-1], 2000)
    assert model.sweep(planned.joints, required=0.008).clearance.min() > 0.007
    assert (np.abs(motion(t, 1)) <= arm.velocity * 1.001).all()
    assert (np.abs(motion(t, 2)) <= arm.acceleration * 1.001).all()


def test_a_beginning_that_cannot_be_reached_is_said_with_what_to_do(arm):
    with pytest.raises(NoSolution, match=r"where the motion begins \(1.96.*approach=null"):
        plan(skill([2.0, 0, 0.5], [0.5, 0, 0.5]), arm, None, samples=2)
