"""A robot with legs in the worlds of the paper: no pedestal, knees that bend, steps that do not slip."""

import numpy as np
import pytest

from robot import worldfile
from robot.arm import Arm
from robot.events import planned_events
from robot.execution import perform
from robot.mounting import mounted
from robot.planner import plan
from robot.simulated import Robot
from robot.world import World
from teach.basis import SquaredExponential
from teach.scripted import smooth_path
from teach.sketch import Event
from teach.trajectory import Skill, TrajectoryDistribution


@pytest.fixture(scope="module")
def dog():
    return Arm.load("aliengo_z1")


def test_an_arm_keeps_its_mount_and_a_dog_stands_where_the_world_says(dog):
    spec = worldfile.read("close_drawer")
    assert mounted(spec, Arm.load("z1"))[0] is spec
    without, there = mounted(spec, dog)
    assert "pedestal" not in {thing["name"] for thing in without["objects"]}
    np.testing.assert_allclose(there.home[:3], spec["stand"])
    np.testing.assert_array_equal(there.home[3:], dog.home[3:])
    worldfile.check(without | {"seed": 3})


@pytest.mark.parametrize("where", [{"mount": "table"}, {"stand": [0, 0]}])
def test_a_mount_and_a_stand_that_are_none_are_said(where):
    with pytest.raises(ValueError, match="mount 'table' is not an object|stand"):
        worldfile.check({"name": "w", "objects": []} | where)


def performed(name, arm):
    """(plan, walk of the legs, Execution) of a world's intended motion."""
    spec, arm = mounted(worldfile.read(name), arm)
    basis, t = SquaredExponential(40, 250.0), np.linspace(0, 1, 200)
    via = [arm.fk(arm.home)[:3, 3], *spec["motion"]["via"][1:]]
    weights = np.linalg.lstsq(basis(t), smooth_path(via), rcond=1e-10)[0]
    events = tuple(Event(event, 3.0 * share) for event, share in spec["motion"].get("events", []))
    skill = Skill(TrajectoryDistribution(basis, weights, 1e-8 * np.eye(120)), 3.0, events)
    with World.from_spec(spec, textured=False) as known:
        known.bring_held(arm, arm.home)
        chosen = plan(skill, arm, known.obstacles, samples=1, orientation=spec["motion"].get("orientation"))
    with World.from_spec(spec, textured=False) as world:
        return chosen, arm.walk(chosen.times, chosen.joints), perform(chosen, arm, world, events=planned_events(skill, chosen), fps=0)


def test_the_dog_bends_its_knees_to_drop_into_the_box(dog):
    chosen, legs, done = performed("drop_into_box", dog)
    assert done.success and done.touched == () and done.metrics["foot_slip_mm"] < 5
    assert legs.joints[-1, 2] < legs.joints[0, 2] - 0.5  # the front left knee
    height = chosen.names.index("trunk_height")
    assert chosen.joints[-1, height] < chosen.joints[0, height] - 0.08


def test_the_dog_marches_while_its_arm_pushes_the_drawer(dog):
    chosen, legs, done = performed("close_drawer", dog)
    assert done.success and done.touched == () and done.metrics["foot_slip_mm"] < 5
    assert legs.steps >= 8 and chosen.joints[-1, 0] > chosen.joints[0, 0] + 0.4
    assert done.metrics["tracking_error_mm"] < 5


def test_standing_feet_stand_on_the_floor_and_that_is_no_touch(dog):
    with World({"name": "w", "objects": [{"name": "floor", "shape": "box", "size": [3, 3, 0.02], "position": [0, 0, -0.41]}]}, textured=False) as world:
        robot = Robot(dog, world.client, dog.home)
        now = np.concatenate([dog.home, dog.walk([0.0], dog.home[None]).joints[0]])
        for _ in range(60):
            robot.step(now, now)
        assert robot.touches() == [] and not np.isnan(robot.feet_down()).any()
        np.testing.assert_allclose(robot.state()[0], dog.home, atol=1e-3)
