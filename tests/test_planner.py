"""Plans: checked, timed within limits, the same for the same seed, and refused with a reason."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from robot import timing
from robot.arm import Arm
from robot.collision import CollisionModel
from robot.contact import as_planned, hand_of
from robot.planner import Plan, plan
from robot.timing import motion_spline, time_path
from scene.camera import Camera, look_at
from teach.basis import SquaredExponential
from teach.hull import visual_hull
from teach.sketch import Event, Sketch, SketchError, Stroke
from teach.trajectory import Route, Skill, TrajectoryDistribution

GOAL = np.array([0.83, 0.10, 0.30])


@pytest.fixture(scope="module")
def arm():
    return Arm.load("panda")


@pytest.fixture(scope="module")
def table():
    """What stands around the goal in the table world of facts/worlds.md."""
    client = BulletClient(pybullet.DIRECT)
    boxes = {
        "top": ([1.2, 2, 0.04], [1.15, 0.1, 0.2]),
        "Cube": ([0.25] * 3, [0.85, 0.5, 0.35]),
        "Object3": ([0.02, 0.2, 0.4], [0.75, 0.3, 0.4]),
        "Object4": ([0.2, 0.05, 0.35], [0.75, -0.1, 0.4]),
    }
    bodies = {
        name: client.createMultiBody(
            0, client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=np.array(size) / 2), -1, at
        )
        for name, (size, at) in boxes.items()
    }
    bodies["Can1"] = client.createMultiBody(
        0, client.createCollisionShape(pybullet.GEOM_CYLINDER, radius=0.03, height=0.12), -1, [0.95, 0.1, 0.3]
    )
    yield SimpleNamespace(client=client, bodies=bodies)
    client.disconnect()


@pytest.fixture
def free():
    client = BulletClient(pybullet.DIRECT)
    yield SimpleNamespace(client=client, bodies={})
    client.disconnect()


def test_an_end_a_little_out_of_reach_gives_way_as_far_as_strokes_leave_it_open(arm, free, tmp_path):
    """The Panda reaches 0.947 m straight ahead at this height."""
    open_end, known_end = (skill_to(arm, [0.98, 0.0, 0.4], spread=spread) for spread in (0.02, 0.001))
    end = open_end.starting_at(arm.fk(arm.home)[:3, 3])[0].distribution.mean_at([1.0])[0]
    assert end[0] > 0.955
    found = plan(open_end, arm, free, samples=2)
    assert found.feasible and 0.01 < np.linalg.norm(found.tip[-1] - end) < 0.03
    assert "before the taught end, which is out of reach" in found.sentence
    found.save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").sentence == found.sentence
    assert plan(skill_to(arm, [0.9, 0.0, 0.4]), arm, free, samples=2).ends == ""
    for refused in (plan(known_end, arm, free, samples=2), plan(open_end, arm, free, samples=2, moved=0.0)):
        assert not refused.feasible and "no posture of the arm reaches the end" in refused.sentence and not refused.ends


def test_a_motion_that_takes_many_times_what_was_drawn_is_told_so(arm, free, tmp_path):
    quick, usual = (plan(skill_to(arm, [0.5, 0.3, 0.5], duration=seconds), arm, free, samples=1) for seconds in (0.06, 4.0))
    assert quick.feasible and "times the 0.1 s that were drawn" in quick.sentence and not usual.slow
    quick.save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").sentence == quick.sentence


def skill_to(arm, goal, lift=0.1, spread=0.02, duration=4.0, **more):
    """A distribution around a bow from where the hand is at home to the goal."""
    s = np.linspace(0, 1, 60)[:, None]
    start = arm.fk(arm.home)[:3, 3]
    points = start + s * (goal - start) + lift * np.sin(np.pi * s) * [0, 0, 1]
    basis = SquaredExponential(10, 30.0)
    W = np.linalg.lstsq(basis(s[:, 0]), points, rcond=None)[0]
    return Skill(TrajectoryDistribution(basis, W, spread**2 * np.eye(30)), duration, **more)


@pytest.fixture(scope="module")
def planned(arm, table):
    return plan(skill_to(arm, GOAL), arm, table, seed=1, samples=6)


def test_the_hand_comes_to_the_goal_between_the_objects(planned, arm):
    assert planned.feasible
    assert np.linalg.norm(planned.tip[-1] - GOAL) < 0.02
    np.testing.assert_allclose(arm.fk(planned.joints)[:, :3, 3], planned.tip)
    assert planned.position_error.max() < 2e-3


def test_the_plan_starts_where_the_arm_is(planned, arm):
    np.testing.assert_allclose(planned.joints[0], arm.home, atol=1e-3)
    assert planned.times[0] == 0 and planned.names == arm.joint_names


def test_the_plan_is_clear_at_every_sample_and_between_them(planned, arm, table):
    model = CollisionModel(arm, table)
    np.testing.assert_allclose(np.minimum(planned.clearance, planned.self_clearance), model.clearance(planned.joints))
    assert model.sweep(planned.joints, required=0.008).clearance.min() > 0.007


def test_the_plan_keeps_velocity_acceleration_and_position_limits(planned, arm):
    motion, t = motion_spline(planned.times, planned.joints), np.linspace(0, planned.times[-1], 2000)
    assert (np.abs(motion(t, 1)) <= arm.velocity * 1.001).all()
    assert (np.abs(motion(t, 2)) <= arm.acceleration * 1.001).all()
    assert arm.within_limits(planned.joints).all()
    np.testing.assert_allclose(motion([0, planned.times[-1]], 1), 0, atol=1e-9)


def test_the_plan_takes_at_least_as_long_as_what_was_shown(planned):
    assert planned.times[-1] >= 4.0 - 1e-9


def test_the_same_seed_gives_the_same_plan(arm, table, planned):
    again = plan(skill_to(arm, GOAL), arm, table, seed=1, samples=6)
    np.testing.assert_array_equal(again.joints, planned.joints)
    assert again.refusals == planned.refusals


def test_a_mean_that_runs_into_something_gives_way_to_a_sample(arm, free):
    skill = skill_to(arm, np.array([0.6, 0.2, 0.3]), spread=0.06)
    shape = free.client.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.03)
    free.bodies["ball"] = free.client.createMultiBody(0, shape, -1, skill.distribution.mean_at([0.6])[0])
    chosen = plan(skill, arm, free, seed=0, samples=20, moved=0)
    assert chosen.feasible and chosen.chosen > 0
    assert chosen.refusals[0].startswith("the mean: at t = 0.") and "into ball" in chosen.refusals[0]


def test_where_nothing_is_feasible_each_refusal_names_place_and_bodies(arm, table):
    chosen = plan(skill_to(arm, np.array([0.75, 0.3, 0.4]), spread=0.002), arm, table, samples=4)
    assert not chosen.feasible and len(chosen.refusals) == chosen.samples == 4
    assert all("t = " in refusal and "Object3" in refusal for refusal in chosen.refusals)
    assert "none of 4" in chosen.sentence and len(chosen.joints) == len(chosen.times)


def outlined(middle, half, numbers=(0,)):
    """Boxes, all seen from two sides, as a person outlines them: by the hull of their corners."""
    middle = np.atleast_2d(middle)
    corners = half * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    sketches = []
    for name, offset in (("left", [-0.3, 1.2, 0.5]), ("right", [-0.3, -1.2, 0.6])):
        camera = Camera.from_fov(look_at(middle[0] + offset, middle[0]), 640, 480, 55)
        seen = [camera.project(at + corners) for at in middle]
        around = [pixels[np.append(ConvexHull(pixels).vertices, ConvexHull(pixels).vertices[0])] for pixels in seen]
        strokes = tuple(Stroke(x, np.arange(len(x)), n, "keep_out") for x, n in zip(around, numbers))
        sketches.append(Sketch(name, camera, strokes))
    return tuple(sketches)


@pytest.fixture(scope="module")
def on_the_way(arm):
    """A skill whose mean runs through a region that its samples may pass by."""
    goal = np.array([0.6, 0.2, 0.3])
    middle = skill_to(arm, goal).distribution.mean_at([0.6])[0]
    return skill_to(arm, goal, spread=0.06, keep_out=outlined(middle, 0.025))


@pytest.mark.parametrize("with_world", [True, False])
def test_a_path_that_enters_a_region_gives_way_to_one_that_keeps_clear_of_it(arm, free, on_the_way, with_world):
    world = free if with_world else None
    allowed = plan(replace(on_the_way, keep_out=()), arm, world, seed=0, samples=20)
    chosen = plan(on_the_way, arm, world, seed=0, samples=20, moved=0)
    (region,) = visual_hull(on_the_way.keep_out)
    assert region.contains(allowed.tip).any() and allowed.feasible
    assert chosen.feasible and chosen.chosen > 0 and not region.contains(chosen.tip).any()
    assert "keep-out region" in chosen.refusals[0] and chosen.refusals[0].startswith("the mean: at t = 0.")
    model = CollisionModel(arm, world, [region])
    np.testing.assert_allclose(np.minimum(chosen.clearance, chosen.self_clearance), model.clearance(chosen.joints))
    assert model.sweep(chosen.joints, required=0.01).clearance.min() >= 0.008
    vertices = np.concatenate([vertices for vertices, _ in region.pieces])
    assert np.linalg.norm(chosen.tip[:, None] - vertices, axis=-1).min() > 0.01


def test_a_region_around_the_goal_leaves_nothing_feasible_and_is_named(arm):
    goal = np.array([0.6, 0.2, 0.3])
    keep_out = outlined([[0.3, -0.5, 0.2], goal], 0.06, numbers=(0, 1))
    chosen = plan(skill_to(arm, goal, spread=0.002, keep_out=keep_out), arm, None, samples=3)
    assert not chosen.feasible and len(chosen.refusals) == 3
    assert all("keep-out region 2" in refusal for refusal in chosen.refusals)


def test_a_start_inside_a_region_is_refused(arm):
    tip = arm.fk(arm.home)[:3, 3]
    skill = skill_to(arm, np.array([0.6, 0.2, 0.3]), keep_out=outlined(tip, 0.03))
    with pytest.raises(ValueError, match="at the start panda_.* mm inside keep-out region .*start the arm elsewhere"):
        plan(skill, arm, None, samples=2)


def test_outlines_that_bound_no_region_are_not_planned_around(arm):
    skill = skill_to(arm, GOAL, keep_out=outlined(GOAL, 0.05)[:1])
    with pytest.raises(SketchError, match="only on view 'left'"):
        plan(skill, arm, None, samples=2)


def test_a_goal_out_of_reach_is_refused(arm):
    chosen = plan(skill_to(arm, np.array([1.6, 0.1, 0.6]), spread=0.01), arm, None, samples=3)
    assert not chosen.feasible and all("reach" in refusal for refusal in chosen.refusals)


def test_a_start_in_collision_or_out_of_limits_is_refused(arm, table):
    skill = skill_to(arm, GOAL)
    inside = arm.ik(pose_at(arm, [0.75, 0.1, 0.22]))
    with pytest.raises(ValueError, match="inside top|from top"):
        plan(skill, arm, table, start=inside, samples=2)
    with pytest.raises(ValueError, match="limits of panda_joint1"):
        plan(skill, arm, table, start=arm.home + [4, 0, 0, 0, 0, 0, 0], samples=2)
    with pytest.raises(ValueError, match="7 finite joint values"):
        plan(skill, arm, table, start=[0, 0], samples=2)


def pose_at(arm, position):
    pose = arm.fk(arm.home)
    pose[:3, 3] = position
    return pose


def test_a_motion_through_the_robots_own_base_is_refused(arm):
    assert not plan(skill_to(arm, np.array([0.02, 0.0, 0.1]), lift=0, spread=0.001), arm, None, samples=2).feasible


def test_a_taught_orientation_is_kept(arm):
    level = Rotation.from_matrix(arm.fk(arm.home)[:3, :3])
    turned = (level * Rotation.from_euler("z", 40, degrees=True)).as_quat()
    chosen = plan(
        skill_to(arm, np.array([0.5, 0.2, 0.4]), spread=0.005, orientation=np.array([[0.5, *turned], [1.0, *turned]])),
        arm,
        None,
        samples=2,
    )
    assert chosen.feasible
    assert (
        Rotation.from_matrix(arm.fk(chosen.joints[-1])[:3, :3]) * Rotation.from_quat(turned).inv()
    ).magnitude() < 0.01


def test_a_plan_survives_its_file(planned, tmp_path):
    planned.save(tmp_path / "plan.npz")
    loaded = Plan.load(tmp_path / "plan.npz")
    np.testing.assert_array_equal(loaded.joints, planned.joints)
    assert (loaded.names, loaded.refusals, loaded.feasible, loaded.sentence) == (
        planned.names,
        planned.refusals,
        planned.feasible,
        planned.sentence,
    )
    assert [f.name for f in tmp_path.iterdir()] == ["plan.npz"]


def test_what_is_no_plan_file_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        Plan.load(tmp_path / "plan.npz")
    (tmp_path / "plan.npz").write_bytes(b"nonsense")
    with pytest.raises(ValueError, match="not a plan file"):
        Plan.load(tmp_path / "plan.npz")


def test_the_joint_trajectory_has_ros_layout_and_begins_at_the_present_state(planned, arm):
    message = json.loads(json.dumps(planned.joint_trajectory()))
    assert message["joint_names"] == list(arm.joint_names)
    first, last = message["points"][0], message["points"][-1]
    np.testing.assert_allclose(first["positions"], arm.home, atol=1e-3)
    np.testing.assert_allclose([*first["velocities"], *last["velocities"]], 0, atol=1e-9)
    assert first["time_from_start"] == {"sec": 0, "nanosec": 0}
    seconds = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in message["points"]]
    np.testing.assert_allclose(seconds, planned.times, atol=1e-8)


def test_time_optimal_motion_of_one_joint_is_bang_bang():
    path = np.linspace(0, 1, 50)[:, None]
    times, joints, waypoints = time_path(path, np.array([100.0]), np.array([4.0]), rate=200, share=0.95)
    assert 1.0 <= times[-1] < 1.1  # 2 sqrt(distance / acceleration) at the full limit
    np.testing.assert_allclose(joints[:, 0] * 49, waypoints, atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_the_fastest_motion_keeps_the_limits_everywhere_and_uses_them(arm, seed):
    path = np.linspace(0, 1, 60)[:, None] * (arm.random(1, seed) - arm.home) + arm.home
    path += 0.2 * np.sin(np.linspace(0, 2 * np.pi, 60))[:, None] * np.random.default_rng(seed).normal(size=7)
    times, joints, _ = time_path(path, arm.velocity, arm.acceleration)
    motion, t = motion_spline(times, joints), np.linspace(0, times[-1], 5000)
    speed, push = np.abs(motion(t, 1)) / arm.velocity, np.abs(motion(t, 2)) / arm.acceleration
    assert speed.max() <= 1.001 and push.max() <= 1.001
    assert max(speed.max(), push.max()) > 0.7


def test_a_motion_does_not_stop_on_its_way_where_timing_it_is_badly_rounded(monkeypatch):
    rng = np.random.default_rng(32)  # one of 300 such paths that stop on the coarsest grid
    knots, s = rng.normal(0, 0.5, (6, 7)), np.linspace(0, 1, 100) ** rng.uniform(0.6, 1.6)
    path, limits = CubicSpline(np.linspace(0, 1, 6), knots)(s), (np.full(7, 2.175), np.array([15, 7.5, 10, 12.5, 15, 20, 20]))
    duration = time_path(path, *limits)[0][-1]
    monkeypatch.setattr(timing, "FINER", (8,))
    assert duration < 1.05 * time_path(path, *limits)[0][-1]


def test_a_motion_that_goes_nowhere_is_held_for_its_duration():
    times, joints, _ = time_path(np.zeros((10, 3)), np.ones(3), np.ones(3), duration=2.0)
    assert times[-1] == pytest.approx(2.0) and (joints == 0).all()


def test_repeated_waypoints_are_no_obstacle_to_timing():
    path = np.repeat(np.linspace([0, 0], [1, 0.5], 20), 3, axis=0)
    times, joints, waypoints = time_path(path, np.ones(2), np.ones(2))
    assert np.isfinite(joints).all() and (np.diff(waypoints) >= 0).all()
    np.testing.assert_allclose(joints[[0, -1]], path[[0, -1]], atol=1e-9)


def test_a_motion_with_corners_is_performed_with_its_corners(arm, free):
    start = arm.fk(arm.home)[:3, 3]
    corners = start + np.array([[0, 0, 0], [0.0, 0.2, 0], [0.0, 0.02, -0.25], [0.0, 0.2, -0.25]])
    t, basis = np.linspace(0, 1, 400), SquaredExponential()
    path = np.stack([np.interp(t, [0, 0.435, 0.555, 1], axis) for axis in corners.T], axis=1)
    weights = np.linalg.lstsq(basis(t), path, rcond=1e-6)[0]
    skill = Skill(TrajectoryDistribution(basis, weights, 1e-9 * np.eye(weights.size)), 3.0)
    planned = plan(skill, arm, free, samples=1)
    assert planned.feasible, planned.refusals
    assert np.linalg.norm(planned.tip[:, None] - corners[1:3], axis=-1).min(axis=0).max() < 0.006


def test_likely_and_clear_are_weighed_against_each_other(arm, free):
    skill = skill_to(arm, GOAL, spread=0.02)
    middle = skill.starting_at(arm.fk(arm.home)[:3, 3])[0].distribution.mean_at([0.5])[0]
    ball = free.client.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.02)
    free.bodies["Ball"] = free.client.createMultiBody(0, ball, -1, middle - [0, 0, 0.1])
    mean = plan(skill, arm, free, samples=1)
    nearly = plan(skill, arm, free, samples=12, comfortable=mean.clearance.min() + 0.001)
    far_from = plan(skill, arm, free, samples=12, comfortable=mean.clearance.min() + 0.02)
    free.client.removeBody(free.bodies.pop("Ball"))
    assert nearly.chosen == 0
    assert far_from.chosen > 0 and far_from.clearance.min() > mean.clearance.min() + 0.002


def test_a_sample_that_is_taken_instead_of_the_mean_ends_where_that_does(arm, free):
    skill = skill_to(arm, GOAL, spread=0.05)
    middle = skill.starting_at(arm.fk(arm.home)[:3, 3])[0].distribution.mean_at([0.5])[0]
    ball = free.client.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.02)
    free.bodies["Ball"] = free.client.createMultiBody(0, ball, -1, middle)
    found = plan(skill, arm, free, samples=12, moved=0)
    free.client.removeBody(free.bodies.pop("Ball"))
    assert found.feasible and found.chosen > 0 and np.linalg.norm(found.tip[-1] - GOAL) < 0.025


def test_planning_takes_another_way_where_the_usual_one_is_blocked(arm, free):
    usual, other = (skill_to(arm, GOAL, lift=lift, spread=0.004).distribution for lift in (-0.12, 0.2))
    skill = Skill(usual, 4.0, routes=(Route(0.6, usual), Route(0.4, other)))
    assert plan(skill, arm, free, samples=6).way == 0
    middle = skill.starting_at(arm.fk(arm.home)[:3, 3])[0].distribution.mean_at([0.5])[0]
    box = free.client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.06, 0.06, 0.06])
    free.bodies["Box"] = free.client.createMultiBody(0, box, -1, middle - [0, 0, 0.06])
    planned = plan(skill, arm, free, samples=6)
    assert planned.feasible and planned.way == 1 and "way 2" in planned.sentence
    assert np.abs(planned.tip[-1] - GOAL).max() < 0.05


def test_the_way_that_is_taken_is_kept_with_the_plan(planned, tmp_path):
    replace(planned, way=1).save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").way == 1


def test_the_first_point_is_exactly_the_present_state(planned, arm):
    np.testing.assert_array_equal(planned.joints[0], arm.home)


def test_a_box_keeps_out_one_link_alone_and_must_name_one_that_is_there(arm):
    goal = np.array([0.5, 0.2, 0.4])
    box = {"name": "box", "lower": (goal - 0.06).tolist(), "upper": (goal + 0.06).tolist()}
    elbows, hands = (
        plan(skill_to(arm, goal, spread=0.003), arm, None, samples=2, keep_out=[box | {"links": [link]}], moved=0)
        for link in ("panda_link4", "panda_hand")
    )
    assert elbows.feasible and not hands.feasible and "panda_hand" in hands.refusals[0]
    for wrong, message in (({"links": ["elbow"]}, "names 'elbow'"), ({"upper": [0, 0, 0]}, "lower below upper"), ({"link": "x"}, "has a name")):
        with pytest.raises(ValueError, match=message):
            plan(skill_to(arm, goal), arm, None, samples=2, keep_out=[box | wrong])


def test_what_is_not_there_cannot_be_held(arm, free):
    with pytest.raises(ValueError, match="'cup' cannot be held"):
        plan(skill_to(arm, GOAL), arm, free, samples=2, held=["cup"])


def test_a_distribution_that_never_varies_is_planned_as_its_mean(arm):
    taught = skill_to(arm, np.array([0.5, 0.2, 0.4]))
    still = TrajectoryDistribution(taught.distribution.basis, taught.distribution.mean, np.zeros((30, 30)))
    assert plan(Skill(still, 4.0), arm, None, samples=2).feasible


def test_a_motion_that_ends_with_a_contact_ends_where_the_hand_touches(arm, table):
    """The table's top, away from what stands on it: without the contact its surface is an obstacle like any other."""
    at = np.array([0.62, -0.45, 0.22])
    taught = skill_to(arm, at, spread=0.005)
    assert not plan(taught, arm, table, samples=2, moved=0).feasible
    landed = plan(replace(taught, events=(Event("contact", 4.0),)), arm, table, samples=2, moved=0)
    assert landed.feasible and np.linalg.norm(landed.tip[-1] - taught.distribution.mean_at([1.0])[0]) < 0.006
    touching = as_planned(arm, landed)
    assert touching.fk(landed.joints[-1])[:3, 3] == pytest.approx(landed.tip[-1])
    distance = CollisionModel(touching, table, only={"top": hand_of(arm)}).measure(landed.joints)[0][:, 0]
    assert 0.0005 < distance[-1] < 0.005 and distance.min() > 0
    others = CollisionModel(touching, table, only={"top": arm.beside_hand}).measure(landed.joints)[0][:, 0]
    assert others.min() >= 0.008


def test_a_hand_that_is_to_grasp_where_it_touches_keeps_its_fingers_open(arm, table):
    at = np.array([0.62, -0.45, 0.22])
    events = (Event("contact", 4.0), Event("gripper_close", 4.0))
    landed = plan(skill_to(arm, at, spread=0.005, events=events), arm, table, samples=2, moved=0)
    assert landed.feasible and (landed.fingers == arm.gripper.open).all() and not landed.contact.any()
    assert landed.tip[-1] == pytest.approx(arm.fk(landed.joints[-1])[:3, 3]) and np.linalg.norm(landed.tip[-1] - at) < 0.015


def test_a_contact_on_the_way_lets_nothing_come_near(arm, table):
    taught = skill_to(arm, np.array([0.62, -0.45, 0.22]), spread=0.005, events=(Event("contact", 2.0),))
    assert not plan(taught, arm, table, samples=2, moved=0).feasible
