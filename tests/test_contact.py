"""Which point of the hand touches: where its shapes, and what it holds, end along the tip's axis."""


import numpy as np
import pytest

from robot import worldfile
from robot.arm import Arm
from robot.collision import CollisionModel
from robot.contact import closing, hand_of, touching
from robot.execution import perform
from robot.planner import plan
from robot.world import World
from teach.basis import SquaredExponential
from teach.sketch import Event
from teach.trajectory import Skill, TrajectoryDistribution

STYLUS = """<robot name="stylus"><link name="base"/>
<link name="arm"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.05 0.05 1"/></geometry></collision></link>
<link name="tip"><collision><origin xyz="0.02 0 0.1" rpy="0.7 0.4 0"/><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="9"/></joint>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 1.2"/></joint></robot>"""


@pytest.fixture(scope="module")
def panda():
    return Arm.load("panda")


def test_the_pandas_closed_fingers_end_7_mm_before_its_tip_frame(panda):
    hand = touching(panda, CollisionModel(panda), ())
    assert hand.contact == pytest.approx([0, 0, 0.0072], abs=2e-4)
    assert (hand.gripper.open == panda.gripper.closed).all() and (panda.gripper.open > 0).all()


def test_forward_and_inverse_kinematics_are_of_the_point_that_touches(panda):
    hand = touching(panda, CollisionModel(panda), ())
    for q in panda.random(5, 0):
        frame = panda.fk(q)
        assert hand.fk(q) == pytest.approx(frame @ _shifted(hand.contact))
        step = 1e-6 * np.eye(7)
        numeric = np.column_stack([(hand.fk(q + d)[:3, 3] - hand.fk(q - d)[:3, 3]) / 2e-6 for d in step])
        assert hand.jacobian(q)[:3] == pytest.approx(numeric, abs=1e-6)
    assert hand.fk(hand.ik(hand.fk(q)))[:3, 3] == pytest.approx(hand.fk(q)[:3, 3], abs=1e-3)


def test_the_z1s_tip_frame_is_where_its_fingers_end():
    arm = Arm.load("z1")
    assert np.abs(touching(arm, CollisionModel(arm), ()).contact).max() < 1e-6


def test_a_ball_beside_the_axis_touches_with_its_own_end(tmp_path):
    (tmp_path / "stylus.urdf").write_text(STYLUS)
    arm = Arm.load(tmp_path / "stylus.urdf")
    assert hand_of(arm) == ["arm", "tip"]
    assert touching(arm, CollisionModel(arm), ()).contact == pytest.approx([0.02, 0, 0.11], abs=0.02)
    assert touching(arm, CollisionModel(arm), ()).contact[2] == pytest.approx(0.11, abs=1e-9)


def test_what_is_held_touches_and_the_fingers_stay_on_it(panda):
    spec = worldfile.read("tiny")
    spec["held"] = {"name": "stick", "shape": "cylinder", "radius": 0.01, "height": 0.2, "position": [0, 0, 0.03], "mass": 0.05}
    with World.from_spec(spec) as world:
        world.bring_held(panda, panda.home)
        model = CollisionModel(panda, world.obstacles, held={"stick": panda.home})
        hand = touching(panda, model, ())
    assert hand.contact == pytest.approx([0, 0, 0.13], abs=2e-3) and (hand.gripper.open == panda.gripper.open).all()


def test_the_hand_reaches_the_point_in_the_simulator(panda):
    """Bullet's own measure, after the motors have moved it: 1 cm is asked of it."""
    at = np.array([0.62, -0.37, 0.22])
    spec = worldfile.read("table")
    t, basis, start = np.linspace(0, 1, 60)[:, None], SquaredExponential(10, 30.0), panda.fk(panda.home)[:3, 3]
    weights = np.linalg.lstsq(basis(t[:, 0]), start + t * (at - start) + 0.1 * np.sin(np.pi * t) * [0, 0, 1], rcond=None)[0]
    taught = TrajectoryDistribution(basis, weights, 0.005**2 * np.eye(30))
    with World.from_spec(spec, textured=False) as world:
        chosen = plan(Skill(taught, 3.0, events=(Event("contact", 3.0),)), panda, world.obstacles, samples=2)
        done = perform(chosen, panda, world, fps=0)
    assert chosen.feasible and not done.touched
    assert done.touch_error < 0.005 and done.metrics["touch_error_mm"] < 5
    assert np.linalg.norm(done.tip[-1] - taught.mean_at([1.0])[0]) < 0.01
    assert "from the point that it was to touch" in done.sentence


@pytest.mark.parametrize(("name", "beside"), [("panda", [0.0, 0.028, -0.01]), ("z1", [-0.05, 0.0, -0.03])])
def test_fingers_that_would_close_on_something_are_refused(name, beside):
    """A pin between the open finger and where it ends: clear of the open hand, clear of the closed one."""
    arm = Arm.load(name)
    start = (arm.fk(arm.home) @ _shifted(beside))[:3, 3]
    towards = start + np.array([0.12, 0.05, 0.0])
    pin = {"name": "pin", "shape": "cylinder", "radius": 0.001, "height": 0.002, "position": start.tolist()}
    wall = {"name": "wall", "shape": "box", "size": [0.02, 0.02, 0.02], "position": towards.tolist()}
    t, basis, begin = np.linspace(0, 1, 60), SquaredExponential(10, 30.0), arm.fk(arm.home)[:3, 3]
    weights = np.linalg.lstsq(basis(t), begin + t[:, None] * (towards - begin), rcond=None)[0]
    touches = Skill(TrajectoryDistribution(basis, weights, 1e-8 * np.eye(30)), 3.0, events=(Event("contact", 3.0),))
    with World.from_spec({"name": "pin", "objects": [pin, wall]}, textured=False) as world:
        for hand in (arm, touching(arm, CollisionModel(arm), ())):
            assert CollisionModel(hand, world).clearance(arm.home) > 0.006
        assert "pin" in closing(arm, world, (), arm.home, 0.006)
        with pytest.raises(ValueError, match=r"the fingers close at the start: there \w+ comes within 6 mm of pin"):
            plan(touches, arm, world.obstacles, samples=1, margin=0.006)
    with World.from_spec({"name": "no pin", "objects": [wall]}, textured=False) as world:
        assert closing(arm, world, (), arm.home, 0.006) is None


def test_a_hand_that_touches_is_closed_along_the_whole_way(panda):
    """Two posts beside the hand, nearer than its open fingers: it is the closed hand whose clearance is told."""
    closed = touching(panda, CollisionModel(panda), ())
    posts = [{"name": f"post{side:+d}", "shape": "cylinder", "radius": 0.01, "height": 0.02,
              "position": (panda.fk(panda.home) @ _shifted([0.0, 0.055 * side, 0.0]))[:3, 3].tolist()} for side in (-1, 1)]  # fmt: skip
    with World.from_spec({"name": "posts", "objects": posts}, textured=False) as world:
        assert CollisionModel(panda, world).clearance(panda.home) < 0
        assert CollisionModel(closed, world).clearance(panda.home) > 0.01
        assert closing(panda, world, (), panda.home, 0.01) is not None


def _shifted(offset) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose
