"""Where to stand: what is said of a place is true there, and a robot with legs goes to it."""

import numpy as np
import pytest

from robot import base, worldfile
from robot.arm import Arm, NoSolution
from robot.attempt import Search
from robot.collision import CollisionModel
from robot.mounting import mounted
from robot.planner import plan
from robot.world import World
from teach.basis import SquaredExponential
from teach.trajectory import Skill, TrajectoryDistribution


@pytest.fixture(scope="module")
def arm():
    return Arm.load("z1")


def skill(*via):
    """Straight from point to point, without doubt."""
    s, basis = np.linspace(0, 1, 60), SquaredExponential(20, 80.0)
    points = np.stack([np.interp(s, np.linspace(0, 1, len(via)), axis) for axis in np.transpose(via)], axis=1)
    return Skill(TrajectoryDistribution(basis, np.linalg.lstsq(basis(s), points, rcond=1e-8)[0], 1e-8 * np.eye(60)), 2.0)


def box(name, size, position):
    return {"name": name, "shape": "box", "size": size, "position": position}


def world(*objects):
    return World.from_spec({"name": "w", "objects": list(objects)}, textured=False)


def test_of_a_robot_that_is_moved_what_stands_around_is_as_far_as_if_that_were_moved(arm):
    T = base._displaced([0.2, -0.1], 0.4)
    inverse = np.linalg.inv(T)
    yaw = float(np.degrees(np.arctan2(inverse[1, 0], inverse[0, 0])))
    postures = arm.random(30, 0)
    at = np.array([0.5, 0.1, 0.4])
    with world(box("a", [0.2, 0.3, 0.1], at.tolist()), box("mount", [0.2, 0.2, 0.3], [0, 0, -0.15])) as w:
        moved = CollisionModel(arm, w).standing(T, "mount")
    there = box("a", [0.2, 0.3, 0.1], (inverse[:3, :3] @ at + inverse[:3, 3]).tolist()) | {"rpy_deg": [0, 0, yaw]}
    with world(there, box("mount", [0.2, 0.2, 0.3], [0, 0, -0.15])) as w:
        np.testing.assert_allclose(moved.clearance(postures), CollisionModel(arm, w).clearance(postures), atol=1e-6)


def test_gaps_are_the_distances_between_things(arm):
    with world(box("a", [0.2, 0.2, 0.2], [1, 0, 0]), box("b", [0.2, 0.2, 0.2], [1, 0.5, 0]), box("c", [0.2, 0.2, 0.2], [1.3, 0.6, 0.0])) as w:
        gaps = CollisionModel(arm, w).gaps("a")
    assert gaps == pytest.approx({"b": 0.3, "c": np.hypot(0.1, 0.4)}, abs=1e-6)


def test_it_is_said_of_an_arm_where_its_base_would_have_to_stand_and_there_the_motion_is_feasible(arm):
    begin = arm.fk(arm.home)[:3, 3]
    end = np.array([0.45, 0.95, 0.4])
    with world() as w:
        refused = plan(skill(begin, end), arm, w.obstacles, samples=2, stand="say")
        assert not refused.feasible and "if the base stood" in refused.sentence and "left" in refused.stands
        left = float(refused.stands.partition("stood ")[2].partition(" m further left")[0].split(" and ")[-1].split()[-1])
        forward = float(refused.stands.partition("stood ")[2].split()[0]) if "forward" in refused.stands else 0.0
        shift = np.array([-forward if "back" in refused.stands else forward, left, 0])
        moved = Skill(skill(begin, end - shift).distribution, 2.0)
        assert plan(moved, arm, w.obstacles, samples=2).feasible
        assert not plan(skill(begin, end), arm, w.obstacles, samples=2).stands  # unasked, nothing is said


def test_a_beginning_out_of_reach_is_refused_with_the_place_to_stand(arm):
    with world() as w, pytest.raises(NoSolution, match="it would be feasible if the base stood .* further left"):
        plan(skill([0.4, 1.0, 0.4], [0.5, 0.9, 0.4]), arm, w.obstacles, samples=1, stand="say")


def test_the_mount_does_not_come_to_stand_in_a_thing(arm):
    pedestal, end = box("pedestal", [0.24, 0.24, 0.4], [0, 0, -0.2]), [0.45, 0.95, 0.4]
    crowd = [box(f"thing{k}", [0.3, 0.05, 0.3], [x, 0.25, -0.2]) for k, x in enumerate((-0.3, 0.0, 0.3))]
    taught = skill(arm.fk(arm.home)[:3, 3], end)
    found = {}
    for name, others in (("free", []), ("crowded", crowd)):
        with world(pedestal, *others) as w:
            search = Search(arm, CollisionModel(arm, w), arm.home, 0.01, 0.03, 12)
            found[name] = base.search(search, taught, 0.15, "pedestal").shift
    lower, upper = found["crowded"] - 0.12, found["crowded"] + 0.12
    for thing in crowd:
        low, high = (np.array(thing["position"][:2]) + side * np.array(thing["size"][:2]) / 2 for side in (-1, 1))
        assert ((upper <= low) | (high <= lower)).any()
    assert not np.allclose(found["free"], found["crowded"])


def test_where_no_place_helps_there_is_none(arm):
    with world() as w:
        search = Search(arm, CollisionModel(arm, w), arm.home, 0.01, 0.03, 12)
        assert base.search(search, skill(arm.fk(arm.home)[:3, 3], [0.5, 0, 2.5]), 0.15) is None
        with pytest.raises(ValueError, match="stand is one of here, walk, say"):
            plan(skill(arm.fk(arm.home)[:3, 3], [0.5, 0, 0.5]), arm, w.obstacles, stand="fly")


def test_a_robot_with_legs_stands_clear_where_its_place_is_and_that_is_a_posture_of_its_own():
    dog = Arm.load("aliengo_z1")
    with world(box("crate", [0.3, 0.6, 0.5], [0.45, 0.0, -0.15])) as w:
        model = CollisionModel(dog, w)
        search = Search(dog, model, dog.home, 0.01, 0.03, 4)
        place = base.search(search, skill([0.8, 0.3, 0.3], [0.8, 0.1, 0.0]), 0.15)
        assert model.clearance(place.start) >= 0.01 and dog.within_limits(place.start)[0]
    np.testing.assert_allclose(dog.fk(place.start), place.world_from_moved @ dog.fk(dog.home), atol=1e-9)
    np.testing.assert_array_equal(place.start[3:], dog.home[3:])


def test_a_robot_with_legs_stands_only_where_there_is_floor_under_its_feet():
    dog = Arm.load("aliengo_z1")
    stands_on = lambda w, shift: base._stands_on(search := Search(dog, CollisionModel(dog, w), dog.home, 0.01, 0.03, 4), base._place(search, np.array(shift), 0.0))
    at = [*dog.home[:2], dog.legs.ground - 0.01]
    with world(box("floor", [1.4, 1.4, 0.02], at)) as w:
        assert stands_on(w, [0.2, 0.0]) and not stands_on(w, [0.6, 0.0]) and not stands_on(w, [0.0, -0.8])
    with world(box("crate", [0.3, 0.3, 0.3], [3.0, 0.0, 0.0])) as w:
        assert stands_on(w, [0.6, 0.0])  # the world says nothing of a floor


@pytest.mark.slow  # half a minute of looking for the way around
def test_a_robot_with_legs_walks_around_what_is_in_the_way_to_where_it_can():
    spec, dog = mounted(worldfile.read("drop_into_box"), Arm.load("aliengo_z1"))
    taught = skill([1.0, 0.3, 0.3], [1.0, -0.3, 0.1])
    with World.from_spec(spec, textured=False) as w:
        with pytest.raises(NoSolution):
            plan(taught, dog, w.obstacles, samples=2, stand="here")
        chosen = plan(taught, dog, w.obstacles, samples=2)
        model = CollisionModel(dog, w)
    assert chosen.feasible and "it goes to stand" in chosen.sentence and 0 < chosen.begins < chosen.times[-1]
    np.testing.assert_array_equal(chosen.joints[0], dog.home)
    assert np.linalg.norm(chosen.joints[-1, :2] - dog.home[:2]) > 1
    assert model.clearance(chosen.joints[::5]).min() > 0.008
    taught_part = chosen.tip[chosen.times >= chosen.begins]
    np.testing.assert_allclose(taught_part[[0, -1]], [[1.0, 0.3, 0.3], [1.0, -0.3, 0.1]], atol=5e-3)
