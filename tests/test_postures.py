"""How the hand is turned along a planned path, what only the hand may touch, and what it carries."""

import numpy as np
import pytest

from robot.arm import Arm
from robot.inverse import tool_of
from robot.planner import plan
from robot.postures import TURNINGS
from robot.world import World
from teach.basis import SquaredExponential
from teach.trajectory import Skill, TrajectoryDistribution

DOWN = [1.0, 0.0, -1.0]
WALL = {"name": "wall", "shape": "box", "size": [0.4, 0.02, 1.0], "position": [0.45, 0.25, 0.5]}


@pytest.fixture(scope="module")
def z1():
    return Arm.load("z1")


def straight(arm, end) -> Skill:
    """Straight from the hand at home to ``end`` (3,), without doubt."""
    basis, t = SquaredExponential(40, 250.0), np.linspace(0, 1, 200)
    begin = arm.fk(arm.home)[:3, 3]
    weights = np.linalg.lstsq(basis(t), begin + t[:, None] * (end - begin), rcond=1e-10)[0]
    return Skill(TrajectoryDistribution(basis, weights, 1e-8 * np.eye(120)), 2.0)


def angle(a, b):
    return np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(b), -1, 1)))


def test_the_hand_points_along_the_axis_once_it_has_turned_there(z1):
    chosen = plan(straight(z1, np.array([0.45, 0.12, 0.20])), z1, None, samples=1, orientation=DOWN)
    assert chosen.feasible
    tips, way = z1.fk(chosen.joints), np.linalg.norm(chosen.tip - chosen.tip[0], axis=1)
    assert max(angle(z, np.array(DOWN)) for z in tips[way > (TURNINGS[0] + 0.02) * way[-1], :3, 2]) < 1
    np.testing.assert_allclose(tips[0], z1.fk(z1.home), atol=1e-3)


def test_a_kept_hand_stays_turned_as_it_is_and_a_tangent_one_points_along_the_path(z1):
    end = np.array([0.45, 0.12, 0.35])
    kept = plan(straight(z1, end), z1, None, samples=1, orientation="keep")
    assert kept.feasible
    np.testing.assert_allclose(z1.fk(kept.joints)[:, :3, :3], np.broadcast_to(z1.fk(z1.home)[:3, :3], (len(kept.joints), 3, 3)), atol=0.02)
    begin = z1.fk(z1.home)[:3, 3]
    ahead = plan(straight(z1, begin + [0.06, 0.02, -0.03]), z1, None, samples=1, orientation="tangent")
    assert ahead.feasible and angle(z1.fk(ahead.joints[-1])[:3, 2], np.array([0.06, 0.02, -0.03])) < 2


def test_an_orientation_that_is_none_is_said_and_one_out_of_reach_is_refused(z1):
    with pytest.raises(ValueError, match="free, keep, down, tangent or an axis"):
        tool_of("sideways", 0.0, np.eye(3))
    with pytest.raises(ValueError, match="three numbers with a direction"):
        tool_of([0, 0, 0], 0.0, np.eye(3))
    refused = plan(straight(z1, np.array([0.7, 0.0, 0.3])), z1, None, samples=1, orientation="down")
    assert not refused.feasible and "pointed along (0.00, 0.00, -1.00)" in refused.refusals[0]


def test_only_the_hand_may_touch_what_is_to_be_touched(z1):
    to_wall = straight(z1, np.array([0.42, 0.24, 0.40]))
    through = straight(z1, np.array([0.4, 0.48, 0.35]))
    with World({"name": "w", "seed": 0, "objects": [WALL]}, textured=False) as world:
        assert not plan(to_wall, z1, world.obstacles, samples=1, moved=0).feasible
    with World({"name": "w", "seed": 0, "objects": [WALL], "touch": ["wall"]}, textured=False) as world:
        assert plan(to_wall, z1, world.obstacles, samples=1, moved=0).feasible
        refused = plan(through, z1, world.obstacles, samples=1, moved=0)
        assert not refused.feasible and "wall" in refused.refusals[0]
        hand = set(z1.link_names) - set(z1.beside_hand)
        assert hand == {"link06", "gripperStator", "gripperMover", "tip"} and not any(link in refused.refusals[0] for link in hand)


def test_what_the_hand_carries_keeps_clear_too(z1):
    stick = {"name": "stick", "shape": "box", "size": [0.02, 0.02, 0.3], "position": [0.3, 0, 0], "rpy_deg": [0, 90, 0], "mass": 0.05}
    shelf = {"name": "shelf", "shape": "box", "size": [0.3, 0.2, 0.02], "position": [0.5, 0.3, 0.15]}
    over, spec = straight(z1, np.array([0.45, 0.25, 0.35])), {"name": "w", "seed": 0, "objects": [shelf]}
    with World(spec, textured=False) as world:
        assert plan(over, z1, world.obstacles, samples=1, moved=0, orientation="keep").feasible
    with World(spec | {"held": stick}, textured=False) as world:
        world.bring_held(z1, z1.home)
        refused = plan(over, z1, world.obstacles, samples=1, moved=0, orientation="keep")
    assert not refused.feasible and "stick" in refused.refusals[0] and "shelf" in refused.refusals[0]


def test_a_start_at_random_is_near_home_the_same_for_a_seed_and_none_for_a_hand_that_holds(z1):
    skill, home = straight(z1, np.array([0.45, 0.12, 0.35])), z1.fk(z1.home)[:3, 3]
    first, again, other = (plan(skill, z1, None, samples=1, starts_within=0.08, seed=seed).tip[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert 1e-3 < np.linalg.norm(first - home) <= 0.08 and np.linalg.norm(first - other) > 1e-3
    with pytest.raises(ValueError, match="starts_within at 0"):
        plan(skill, z1, None, samples=1, starts_within=0.08, held=["cup"])


def test_what_is_held_lies_on_the_finger_that_does_not_move(z1):
    cube = {"name": "cube", "shape": "box", "size": [0.03, 0.03, 0.03], "position": [0, 0, 0], "mass": 0.03}
    with World({"name": "w", "seed": 0, "objects": [], "held": cube}, textured=False) as world:
        world.bring_held(z1, z1.home)
        tip_from_cube = np.linalg.inv(z1.fk(z1.home)) @ world.pose("cube")
    np.testing.assert_allclose(tip_from_cube[:3, 3], [-0.015, 0, 0], atol=1e-6)
