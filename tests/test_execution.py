"""Motions performed by simulated motors, judged by where things stand; and their films."""

from dataclasses import replace
from types import SimpleNamespace

import av
import numpy as np
import pytest

from robot import conditions
from robot.arm import Arm
from robot.events import planned_events
from robot.execution import Execution, film_camera, goal_point, judge, perform, save_video
from robot.planner import plan
from robot.simulated import Robot
from robot.world import World
from robot.variation import pre_grasp
from teach.basis import SquaredExponential
from teach.scripted import smooth_path
from teach.sketch import Event
from teach.trajectory import Skill, TrajectoryDistribution


@pytest.fixture(scope="module")
def arm():
    return Arm.load("panda")


@pytest.fixture
def tiny():
    with World.load("tiny", textured=False) as world:
        yield world


def turned(arm, joints, by, duration=2.0):
    """A plan that turns some joints from home and back to rest; not checked against anything."""
    times = np.linspace(0, duration, 101)
    change = np.zeros(len(arm.home))
    change[list(joints)] = by
    share = (1 - np.cos(np.pi * times / duration)) / 2
    return SimpleNamespace(
        times=times, joints=arm.home + share[:, None] * change, names=arm.joint_names, feasible=True, sentence="", touches=False
    )


def taught(world):
    """A skill around the motion that the world intends."""
    s = np.linspace(0, 1, 60)
    points = smooth_path(world.spec["motion"]["via"], 60)
    basis = SquaredExponential(10, 30.0)
    weights = np.linalg.lstsq(basis(s), points, rcond=None)[0]
    return Skill(TrajectoryDistribution(basis, weights, 1e-4 * np.eye(30)), 3.0)


@pytest.fixture(scope="module")
def performed(arm):
    with World.load("tiny") as world:
        chosen = plan(taught(world), arm, world, samples=1, postures=4)
        return chosen, perform(chosen, arm, world, fps=2.0, width=160, height=120)


def test_the_intended_motion_is_planned_performed_and_judged_a_success(performed):
    chosen, done = performed
    assert chosen.feasible and done.success
    assert done.metrics["contacts"] == 0 and done.metrics["final_error_mm"] < 20
    assert done.metrics["tracking_error_mm"] < 5 and "nothing was touched" in done.sentence


def test_the_record_has_a_row_for_every_step_and_its_tip_is_the_arms(performed, arm):
    chosen, done = performed
    assert len(done.times) == len(done.joints) == len(done.tip) == len(done.tip_error)
    np.testing.assert_allclose(np.diff(done.times), 1 / 240)
    assert done.duration == chosen.times[-1] < done.times[-1]
    np.testing.assert_allclose(done.tip, arm.fk(done.joints)[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(done.joints[0], chosen.joints[0], atol=1e-9)


def test_the_hand_is_where_the_plan_has_it_at_the_same_time(performed):
    """Against the tip that the planner stored, not against the targets that the motors were given."""
    chosen, done = performed
    tip = np.stack([np.interp(chosen.times, done.times, axis) for axis in done.tip.T], axis=1)
    np.testing.assert_allclose(tip, chosen.tip, atol=1e-3)


def test_the_film_lasts_as_long_as_the_motion_and_the_robot_moves_in_it(performed):
    _, done = performed
    assert done.frames.shape == (int(done.times[-1] * 2.0) + 1, 120, 160, 3) and done.frames.dtype == np.uint8
    assert np.abs(done.frames[0].astype(int) - done.frames[-1]).max() > 50


def test_what_is_saved_is_loaded_but_for_the_film(performed, tmp_path):
    _, done = performed
    done.save(tmp_path / "execution.npz")
    again = Execution.load(tmp_path / "execution.npz")
    assert (again.metrics, again.sentence, again.names) == (done.metrics, done.sentence, done.names)
    np.testing.assert_array_equal(again.tip, done.tip)
    assert len(again.frames) == 0 and [p.name for p in tmp_path.iterdir()] == ["execution.npz"]


def test_a_thing_in_the_way_is_touched_named_and_spoils_the_success(arm):
    """Joint 1 swings the hand sideways into a post that the plan knew nothing of."""
    post = {"name": "post", "shape": "box", "size": [0.1, 0.1, 1.2], "position": [0.25, 0.32, 0.3]}
    with World.from_spec(
        {"name": "post", "objects": [post], "view": {"target": [0.3, 0, 0.4]}}, textured=False
    ) as world:
        done = perform(turned(arm, [0], 1.2), arm, world, fps=0)
    assert done.touched == ("post",) and not done.success
    assert done.touched_by[0].startswith("panda_") and 0 < done.touched_at[0] < 2 and done.touch_depth[0] > 0
    assert "touched post" in done.sentence


def test_the_same_motion_without_the_post_touches_nothing_and_ends_where_planned(arm, tiny):
    done = perform(turned(arm, [0], 1.2), arm, tiny, fps=0)
    assert done.touched == () and done.tip_error[-1] < 1e-3
    assert not done.success and done.final_error > 0.05  # but not where this world wants it


def test_a_thing_is_pushed_over_a_table_with_the_force_of_its_friction(arm):
    """mu m g, while the hand swings sideways against it."""
    top = {"name": "top", "shape": "box", "size": [0.6, 0.8, 0.04], "position": [0.4, 0.2, 0.36], "friction": 0.5}
    crate = {"name": "crate", "shape": "box", "size": [0.14, 0.1, 0.16], "position": [0.29, 0.14, 0.46], "mass": 2.0, "friction": 0.8}
    spec = {"name": "push", "objects": [top, crate], "touch": ["crate"], "view": {"target": [0.3, 0, 0.4]}}
    with World.from_spec(spec, textured=False) as world:
        done = perform(turned(arm, [0], 0.45, duration=4.0), arm, world, fps=0)
        moved = world.pose("crate")[1, 3] - 0.14
    assert moved > 0.02 and done.touched == ()
    assert done.press == pytest.approx(0.5 * 0.8 * 2.0 * 9.81, rel=0.2)
    assert f"it pressed with up to {done.press:.0f} N" in done.sentence and done.metrics["press_n"] == done.press


def test_a_hand_that_presses_too_hard_on_what_it_is_to_touch_stops_there(arm):
    """What it is to touch does not give way: it stops early, and holds, unless it is told never to; nothing happens after."""
    post = {"name": "post", "shape": "box", "size": [0.1, 0.1, 1.2], "position": [0.25, 0.32, 0.3]}
    spec = {"name": "post", "objects": [post], "touch": ["post"], "view": {"target": [0.3, 0, 0.4]}}
    done = {}
    for press in (60.0, None):
        with World.from_spec(spec, textured=False) as world:
            done[press] = perform(turned(arm, [0], 1.2), arm, world, fps=0, press=press, events=(Event("gripper_close", 2.0),))
    guarded, pushing = done.values()
    assert 60 < guarded.press < 120 < pushing.press and np.isnan(pushing.stopped)
    after = guarded.times > guarded.stopped + 0.3
    assert 0.3 < guarded.stopped < 1.5 and np.ptp(guarded.joints[after], axis=0).max() < 2e-3
    assert guarded.final_error > 0.1 and not guarded.success  # from the plan's end, in a world without a goal
    assert f"it stopped after {guarded.stopped:.2f} of 2.00 s" in guarded.sentence and guarded.metrics["stopped_s"] == guarded.stopped
    assert guarded.metrics["tracking_error_mm"] < pushing.metrics["tracking_error_mm"] and "stopped_s" not in pushing.metrics


@pytest.mark.parametrize("press", [0, -5.0, np.nan])
def test_a_force_that_is_none_is_refused(arm, tiny, press):
    with pytest.raises(ValueError, match="press is a force in N above 0"):
        perform(turned(arm, [0], 0.1), arm, tiny, fps=0, press=press)


def test_motors_are_bound_by_their_effort_and_hold_the_arm_against_gravity(arm, tiny, monkeypatch):
    """An arm whose motors are too weak sinks: the simulated arm is driven, not placed."""
    robot = Robot(arm, tiny.client, arm.home)
    for _ in range(240):
        robot.step(arm.home, arm.home)
    torque = [abs(state[3]) for state in tiny.client.getJointStates(robot.body, robot.joints)]
    assert np.abs(robot.state()[0] - arm.home).max() < 1e-3 and max(torque) > 5
    robot.effort = dict.fromkeys(robot.effort, 1.0)
    for _ in range(240):
        robot.step(arm.home, arm.home)
    assert np.abs(robot.state()[0] - arm.home).max() > 0.2


def test_the_goal_is_read_from_where_the_object_stands_now(tiny):
    before = goal_point(tiny)
    np.testing.assert_allclose(before, pre_grasp(tiny.spec))
    body = tiny.bodies["Can1"]
    position, quat_xyzw = tiny.client.getBasePositionAndOrientation(body)
    tiny.client.resetBasePositionAndOrientation(body, np.add(position, [0, 0.1, 0]), quat_xyzw)
    np.testing.assert_allclose(goal_point(tiny) - before, [0, 0.1, 0], atol=1e-9)
    assert judge(tiny, before)[1][0].value == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("off", "touched", "success"), [(0.0, (), True), (0.049, (), True), (0.051, (), False), (0.0, ("bench",), False)]
)
def test_the_judge_follows_the_worlds_conditions(tiny, off, touched, success):
    _, verdicts = judge(tiny, goal_point(tiny) + [0, 0, off], touched)
    assert all(v.met for v in verdicts) is success and verdicts[0].value == pytest.approx(off)
    assert [v.name for v in verdicts] == ["hand_m", "contacts"]


def test_plans_that_were_refused_or_are_of_another_arm_are_not_performed(arm, tiny):
    refused = turned(arm, [0], 0.1)
    refused.feasible, refused.sentence = False, "the mean: elbow in the wall"
    with pytest.raises(ValueError, match="not feasible.*elbow in the wall"):
        perform(refused, arm, tiny)
    foreign = turned(arm, [0], 0.1)
    foreign.names = ("hip", "knee")
    with pytest.raises(ValueError, match="hip, knee.*panda_joint1"):
        perform(foreign, arm, tiny)


def test_two_performances_of_one_plan_are_equal(arm):
    def once():
        with World.load("tiny", textured=False) as world:
            return perform(turned(arm, [1, 3], 0.3), arm, world, fps=0)

    np.testing.assert_array_equal(once().joints, once().joints)


def test_a_film_is_h264_that_browsers_play(tmp_path):
    frames = np.zeros((10, 61, 81, 3), np.uint8)  # odd sizes lose their last row and column
    frames[:, :, :40] = [200, 30, 30]
    save_video(tmp_path / "film.mp4", frames, 12.5)
    with av.open(str(tmp_path / "film.mp4")) as video:
        stream = video.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt, float(stream.average_rate)) == (
            "h264",
            "yuv420p",
            12.5,
        )
    assert len(pictures) == 10 and pictures[0].shape == (60, 80, 3)
    np.testing.assert_allclose(pictures[5][30, 20], [200, 30, 30], atol=12)
    content = (tmp_path / "film.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # the index comes first, so that it plays while it loads
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_a_film_without_frames_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="at least one frame"):
        save_video(tmp_path / "film.mp4", [], 12.5)
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_no_execution_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        Execution.load(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"not an archive")
    with pytest.raises(ValueError, match="not an execution file"):
        Execution.load(tmp_path / "bad.npz")


def test_a_world_without_a_view_is_filmed_only_by_a_given_camera():
    with pytest.raises(ValueError, match="bare says no view"):
        film_camera({"name": "bare"}, 480, 360)


@pytest.mark.parametrize("name", ["tiny", "table"])
def test_the_film_shows_the_whole_intended_motion(name):
    with World.load(name, textured=False) as world:
        camera = film_camera(world.spec, 480, 360)
        assert camera.contains(camera.project(world.spec["motion"]["via"])).all()


# Grippers, events, and conditions


def still(arm, duration=0.2):
    """A plan that stays at home."""
    return turned(arm, [0], 0.0, duration)


def task(**parts):
    return World.from_spec({"name": "task", "view": {"target": [0.3, 0, 0.3]}, **parts}, textured=False)


SUGAR = {"name": "sugar", "shape": "box", "size": [0.03, 0.03, 0.03], "position": [0, 0, 0], "mass": 0.03}
CUP = {"name": "cup", "shape": "cup", "height": 0.12, "radius": 0.05, "wall": 0.004, "position": [0.307, 0, 0.08], "mass": 0.1}
FLOOR = {"name": "floor", "shape": "box", "size": [1, 1, 0.02], "position": [0.3, 0, 0.01]}
POST = {"name": "post", "shape": "box", "size": [0.1, 0.1, 0.6], "position": [0.2, 0.27, 0.32], "mass": 0.3}


def test_what_is_held_moves_with_the_hand_and_falls_into_the_cup_when_the_gripper_opens(arm):
    inside = {"inside": [{"body": "sugar", "container": "cup"}]}
    with task(objects=[FLOOR, CUP], held=SUGAR, success=inside) as world:
        assert "sugar" not in world.bodies and set(world.obstacles.bodies) == {"floor", "cup"}
        done = perform(still(arm), arm, world, events=[Event("gripper_open", 0.15)], fps=0)
        assert done.success and done.touched == ()
        np.testing.assert_allclose(world.pose("sugar")[:3, 3], [0.307, 0, 0.039], atol=0.02)
    with task(objects=[FLOOR, CUP], held=SUGAR, success=inside) as world:
        kept = perform(turned(arm, [0], 0.5, 1.0), arm, world, fps=0)
        assert not kept.success and "sugar is" in kept.sentence and "outside cup" in kept.sentence
        np.testing.assert_allclose(world.pose("sugar")[:3, 3], kept.tip[-1], atol=2e-3)
        assert kept.metrics["conditions"]["sugar_in_cup_m"]["met"] is False


def test_fingers_stop_at_what_is_between_them(arm):
    with task(objects=[FLOOR], held=SUGAR) as world:
        robot = Robot(arm, world.client, arm.home)
        robot.take(world)
        for _ in range(120):
            robot.step(arm.home, arm.home)
        width = sum(world.client.getJointState(robot.body, finger)[0] for finger in robot.fingers)
        assert width == pytest.approx(0.03, abs=2e-3)
        robot.happen("gripper_open", world)
        for _ in range(120):
            robot.step(arm.home, arm.home)
        width = sum(world.client.getJointState(robot.body, finger)[0] for finger in robot.fingers)
        assert width == pytest.approx(0.08, abs=2e-3) and world.pose("sugar")[2, 3] < 0.3


def test_what_the_task_is_to_touch_is_no_unwanted_contact(arm):
    swing = turned(arm, [0], 1.2)
    with task(objects=[FLOOR, POST], touch=["post"], success={"tilted": [{"body": "post", "degrees": 60}], "below": [{"body": "post", "height": 0.2}]}) as world:
        assert world.obstacles.touch == ("post",)
        done = perform(swing, arm, world, fps=0)
    assert done.touched == () and done.success and dict(zip(done.conditions, done.met)) == {
        "hand_m": True, "contacts": True, "post_height_m": True, "post_tilt_deg": True,
    }  # fmt: skip
    with task(objects=[FLOOR, POST]) as world:
        assert perform(swing, arm, world, fps=0).touched == ("post",)


def test_a_drawer_is_judged_by_its_joint():
    cabinet = {"name": "cabinet", "shape": "box", "size": [0.2, 0.2, 0.2], "position": [0.6, 0, 0.5]}
    drawer = {"name": "drawer", "shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.5, 0, 0.5], "mass": 1.0}
    runner = {"name": "runner", "parent": "cabinet", "child": "drawer", "type": "prismatic", "axis": [-1, 0, 0], "lower": -0.1, "upper": 0.1}
    success = {"closed": [{"joint": "runner", "within": 0.02}], "opened": [{"joint": "runner", "at_least": 0.15}],
               "reached": [{"body": "drawer", "position": [0.6, 0, 0.5], "within": 0.01}]}  # fmt: skip
    with task(objects=[cabinet, drawer], joints=[runner], success=success) as world:
        opening = {}
        for q in (0.0, -0.1, 0.08):
            world.client.resetJointState(world.bodies["drawer"], 0, q)
            opening[q] = [(round(v.value, 3), v.met) for v in conditions.judged(world)]
    assert opening[0.0] == [(0.1, False), (0.1, False), (0.1, False)]
    assert opening[-0.1] == [(0.0, False), (0.0, True), (0.0, True)]
    assert opening[0.08] == [(0.18, True), (0.18, False), (0.18, False)]


def test_a_free_fall_ends_as_fast_as_energy_allows_and_two_worlds_do_not_meet(arm):
    """v = sqrt(2 g h), in a world beside which another one runs."""
    with task(objects=[FLOOR], held=SUGAR) as world, task(objects=[FLOOR, POST]) as other:
        before = other.pose("post")
        done = perform(still(arm), arm, world, events=[Event("gripper_open", 0.1)], fps=0)
        height = arm.fk(arm.home)[2, 3] - 0.035
        assert 0.9 * np.sqrt(2 * 9.81 * height) < done.fastest < 1.02 * np.sqrt(2 * 9.81 * height)
        assert world.speed("sugar") < 0.01
        np.testing.assert_array_equal(other.pose("post"), before)


def test_the_same_task_ends_the_same_way_twice(arm):
    def once():
        with task(objects=[FLOOR, POST], touch=["post"]) as world:
            perform(turned(arm, [0], 1.2), arm, world, fps=0)
            return world.pose("post")

    np.testing.assert_array_equal(once(), once())


def test_events_happen_at_the_same_share_of_the_way(performed):
    chosen, _ = performed
    with World.load("tiny", textured=False) as world:
        skill = replace(taught(world), events=(Event("gripper_open", 3.0), Event("gripper_close", 1.5)))
    first, last = planned_events(skill, chosen)
    assert (first.name, last.name) == ("gripper_close", "gripper_open") and last.time == pytest.approx(chosen.times[-1], abs=0.05)
    there = chosen.tip[np.searchsorted(chosen.times, first.time)]
    np.testing.assert_allclose(there, skill.distribution.mean_at(0.5)[0], atol=0.02)
    assert planned_events(replace(skill, events=()), chosen) == ()


def test_a_filmstrip_shows_the_first_and_the_last_picture(performed):
    _, done = performed
    assert done.strip[0] == 0 and done.strip[-1] == len(done.frames) - 1 and len(done.strip) == 6
