"""The mean gives way as little as its distribution says: least changes in closed form, and around things in the way."""

from types import SimpleNamespace

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pybullet_utils.bullet_client import BulletClient
from scipy.optimize import minimize

from robot.arm import Arm
from robot.collision import CollisionModel
from robot.deform import least
from robot.planner import plan
from teach.basis import SquaredExponential
from teach.trajectory import Skill, TrajectoryDistribution

GOAL = np.array([0.6, 0.2, 0.3])


@pytest.fixture(scope="module")
def arm():
    return Arm.load("panda")


@pytest.fixture
def free():
    client = BulletClient(pybullet.DIRECT)
    yield SimpleNamespace(client=client, bodies={})
    client.disconnect()


def skill(arm, spread, covariance=None):
    s = np.linspace(0, 1, 60)[:, None]
    start = arm.fk(arm.home)[:3, 3]
    points = start + s * (GOAL - start) + 0.1 * np.sin(np.pi * s) * [0, 0, 1]
    basis = SquaredExponential(10, 30.0)
    W = np.linalg.lstsq(basis(s[:, 0]), points, rcond=None)[0]
    return Skill(TrajectoryDistribution(basis, W, spread**2 * (np.eye(30) if covariance is None else covariance)), 4.0)


def put_ball(world, at, radius=0.03):
    shape = world.client.createCollisionShape(pybullet.GEOM_SPHERE, radius=radius)
    world.bodies["ball"] = world.client.createMultiBody(0, shape, -1, at)


def test_one_constraint_is_met_by_the_step_along_its_normal():
    a = np.array([[3.0, 4.0]])
    np.testing.assert_allclose(least(a, np.array([10.0])), [1.2, 1.6], rtol=1e-6)


def test_what_is_met_already_changes_nothing():
    np.testing.assert_allclose(least(np.eye(2), np.array([-1.0, -2.0])), 0, atol=1e-9)


def test_without_constraints_nothing_changes():
    np.testing.assert_array_equal(least(np.zeros((0, 3)), np.zeros(0)), np.zeros(3))


def test_constraints_that_contradict_each_other_are_shared():
    z = least(np.array([[1.0], [-1.0]]), np.array([0.02, 0.01]))
    np.testing.assert_allclose(z, 0.005, atol=1e-4)


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=25)
def test_the_least_change_is_that_of_a_general_solver(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(4, 6)), rng.normal(size=4)
    constraint = {"type": "ineq", "fun": lambda z: A @ z - b, "jac": lambda z: A}
    other = minimize(lambda z: z @ z, np.zeros(6), jac=lambda z: 2 * z, constraints=constraint, method="SLSQP").x
    np.testing.assert_allclose(least(A, b), other, atol=1e-4)
    assert (A @ least(A, b) >= b - 1e-4).all()


def test_where_no_sample_survives_the_mean_moves_around_and_keeps_its_goal(arm, free):
    taught = skill(arm, spread=0.01)
    put_ball(free, taught.distribution.mean_at([0.6])[0])
    without = plan(taught, arm, free, samples=5, moved=0)
    chosen = plan(taught, arm, free, samples=5)
    assert not without.feasible and chosen.feasible and chosen.chosen < 0
    assert "the mean moved by at most" in chosen.sentence and len(chosen.refusals) == 5
    np.testing.assert_allclose(chosen.tip[-1], taught.distribution.mean_at([1.0])[0], atol=2e-3)
    assert CollisionModel(arm, free).sweep(chosen.joints, required=0.01).clearance.min() > 0.008
    np.testing.assert_array_equal(plan(taught, arm, free, samples=5).joints, chosen.joints)


def test_the_mean_moves_the_way_that_its_distribution_leaves_open(arm, free):
    sideways = np.kron(np.eye(10), np.diag([1e-6, 1.0, 1e-6]))
    taught = skill(arm, 0.01, sideways)
    put_ball(free, taught.distribution.mean_at([0.6])[0] + [0, -0.01, 0])
    chosen = plan(taught, arm, free, samples=1, waypoints=50)
    start = taught.starting_at(arm.fk(arm.home)[:3, 3])[0].distribution
    assert chosen.feasible
    apart = chosen.tip[:, None] - start.mean_at(np.linspace(0, 1, 300))
    nearest = apart[np.arange(len(apart)), np.linalg.norm(apart, axis=-1).argmin(axis=1)]
    assert np.abs(nearest[:, 1]).max() > 0.03 and np.abs(nearest[:, [0, 2]]).max() < 0.03


def test_a_mean_that_may_not_move_far_enough_is_refused(arm, free):
    taught = skill(arm, spread=0.01)
    put_ball(free, taught.distribution.mean_at([0.6])[0], radius=0.08)
    chosen = plan(taught, arm, free, samples=3, moved=0.02, waypoints=50)
    assert not chosen.feasible and "moved" in chosen.sentence
