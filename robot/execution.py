"""perform: PyBullet follows a plan under motor control; what happened is recorded, filmed, and judged.

Every simulated step of 1/240 s the motors of all joints get where the plan is now and how fast it moves until the next
step, within the efforts that the URDF allows; gravity acts, the gripper opens and closes at its events. After the
motion the last posture is held until things have come to rest. A hand that presses too hard on what it is to touch stops
where it is (a guarded move): what was drawn may end inside the thing, or behind a drawer once that is shut. The judge reads the simulator's state and the world's
own conditions (conditions.py), never the plan.

    goal = p_object - distance * approach / |approach|      the point before the goal's object, where that stands now
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction

import av
import numpy as np

from robot import conditions
from robot.contact import as_planned
from robot.gait import slipped
from robot.simulated import STEP, Robot
from robot.timing import motion_spline
from scene.camera import Camera, look_at
from scene.files import parse_npz, replacing

AT_REST, PATIENCE = 0.01, 3.0  # m/s; s after the motion that are waited for things to be slower
PRESSED = 0.1  # s, over which a force is averaged: what presses, not what knocks
LASTING = round(PRESSED / STEP)  # steps
STRIP = 6  # pictures of a filmstrip
NO_FILM = np.zeros((0, 0, 0, 3), np.uint8)
WORDS = ("names", "touched", "touched_by", "conditions", "said")
NUMBERS = ("duration", "final_error", "success", "fps", "fastest", "foot_slip", "touch_error", "press", "stopped")


@dataclass(frozen=True, eq=False)
class Execution:
    """What the robot did, a row for each of N control steps; the time after the plan's end is for settling.

    times (N,) [s]. joints (N, J) [rad]. names: of the joints. tip (N, 3) [m]. tip_error (N,) [m]: against the planned
    tip at the same time, or when it stopped. duration [s]: of the plan. touched: bodies that the robot was not to touch and did, in that
    order, with touched_by, the link that did, touched_at (C,) [s] and touch_depth (C,) [m], the deepest overlap. goal
    (3,) [m]: where the tip was to end (nan in a world without a goal). final_error [m]: from there, or else from the
    plan's end. conditions: names of the world's, with what was measured (K,), its bound (K,), whether each is met (K,)
    and said, in words. fastest [m/s]: of all things. foot_slip [m]: the farthest that a foot moved while it stood, 0 without
    legs. touch_error [m]: from where the hand was to touch to the nearest point of it and of what it holds, at the end; nan where it was
    not to. press [N]: the largest force, over PRESSED seconds, on what the robot is to touch and does not hold. stopped [s]: when it stopped for pressing too hard, nan if it did not. success: all are met. frames (F, H, W, 3) uint8 at ``fps``: the
    film, not kept by ``save``.
    """

    times: np.ndarray
    joints: np.ndarray
    names: tuple[str, ...]
    tip: np.ndarray
    tip_error: np.ndarray
    duration: float
    touched: tuple[str, ...]
    touched_by: tuple[str, ...]
    touched_at: np.ndarray
    touch_depth: np.ndarray
    goal: np.ndarray
    final_error: float
    conditions: tuple[str, ...]
    measured: np.ndarray
    bounds: np.ndarray
    met: np.ndarray
    said: tuple[str, ...]
    fastest: float
    success: bool
    foot_slip: float
    touch_error: float
    press: float
    stopped: float
    fps: float
    frames: np.ndarray

    @property
    def strip(self) -> np.ndarray:
        """(STRIP,) which frames a filmstrip shows, evenly over the film; frame k is of time k / fps."""
        return np.linspace(0, int(self.times[-1] * self.fps + 1e-9), STRIP).astype(int)

    @property
    def metrics(self) -> dict:
        """Numbers for metrics.json; the tracking error is of the motion, without the settling and what comes after a stop."""
        error = 1e3 * self.tip_error[self.times <= np.fmin(self.duration, self.stopped) + STEP / 2]
        return {
            "tracking_error_mm": float(np.sqrt(np.mean(error**2))),
            "tracking_error_max_mm": float(error.max()),
            "final_error_mm": 1e3 * float(self.final_error),
            "contacts": len(self.touched),
            "success": bool(self.success),
            "fastest_thing_m_s": float(self.fastest),
            "foot_slip_mm": 1e3 * float(self.foot_slip),
            "press_n": float(self.press),
            **({} if np.isnan(self.stopped) else {"stopped_s": float(self.stopped)}),
            **({} if np.isnan(self.touch_error) else {"touch_error_mm": 1e3 * float(self.touch_error)}),
            "conditions": {name: {"measured": float(value), "bound": float(bound), "met": bool(met)}
                           for name, value, bound, met in zip(self.conditions, self.measured, self.bounds, self.met)},
        }  # fmt: skip

    @property
    def sentence(self) -> str:
        """What came of it, in one line."""
        numbers = self.metrics
        touches = [
            f"{link} touched {body} after {at:.2f} s ({1e3 * depth:.1f} mm deep)"
            for body, link, at, depth in zip(self.touched, self.touched_by, self.touched_at, self.touch_depth)
        ]
        unmet = [said for said, met in zip(self.said, self.met) if not met]
        return (
            f"{'success' if self.success else 'failure'}: the hand ended {numbers['final_error_mm']:.1f} mm from where "
            f"it was to go and followed the plan within {numbers['tracking_error_mm']:.2f} mm RMS, "
            f"{numbers['tracking_error_max_mm']:.2f} mm at most; "
            f"{'; '.join(touches) if touches else 'nothing was touched'}"
            f"{'' if np.isnan(self.touch_error) else f'; it reached to {1e3 * self.touch_error:.1f} mm from the point that it was to touch'}"
            f"{f'; it pressed with up to {self.press:.0f} N on what it was to touch' if self.press >= 1 else ''}"
            f"{'' if np.isnan(self.stopped) else f'; for that it stopped after {self.stopped:.2f} of {self.duration:.2f} s'}"
            f"{'; not as it was to be: ' if unmet else ''}{'; '.join(unmet)}"
        )

    def save(self, path) -> None:
        """Write all but the film to an npz file, whole or not at all."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "frames"}
        words = {name: np.array(values[name], dtype=str) for name in WORDS}
        with replacing(path) as temporary:
            np.savez(temporary, **values | words)

    @classmethod
    def load(cls, path) -> "Execution":
        """Read what ``save`` wrote, with an empty film. Raises FileNotFoundError, or ValueError for any other file."""
        return parse_npz(path, "an execution file", "robot.execute", cls._parsed)

    @classmethod
    def _parsed(cls, arrays) -> "Execution":
        later = {"foot_slip": np.array(0.0), "touch_error": np.array(np.nan), "press": np.array(0.0), "stopped": np.array(np.nan)}  # earlier files have none
        values = {f.name: (later | arrays)[f.name] for f in fields(cls) if f.name != "frames"}
        words = {name: tuple(values[name].tolist()) for name in WORDS}
        numbers = {name: values[name].item() for name in NUMBERS}
        return cls(**values | words | numbers, frames=NO_FILM)


def perform(plan, arm, world, *, events=(), camera=None, fps=12.5, width=480, height=360, settle=0.6, press=100.0) -> Execution:
    """The arm follows the plan among the bodies of the world, which changes by it.

    plan: Plan. arm: Arm. world: World, without a robot in it yet. events: Events at times [s] of the plan; the gripper
    knows "gripper_open" and "gripper_close". camera: Camera that films; None stands it where the world's ``film`` says,
    ``width`` x ``height`` [px]. fps: frames a second; 0 films nothing. settle [s]: how long the last posture is held at
    least before the judge looks. press [N]: with more, over PRESSED seconds, on what it is to touch and does not hold, the robot stops where it
    is, and what was to happen later does not; None: never. Raises ValueError for a plan that is not feasible or of another arm.
    """
    _check(plan, arm, fps, settle, press)
    arm = as_planned(arm, plan)
    camera = film_camera(world.spec, width, height) if camera is None and fps else camera
    robot = Robot(arm, world.client, plan.joints[0])
    robot.take(world)
    motion, duration = motion_spline(plan.times, plan.joints), float(plan.times[-1])
    legs = _legs(arm, motion, duration)
    held = None
    wanted = lambda time: held if held is not None else np.concatenate([motion(min(time, duration)), legs(time)])
    coming = sorted(events, key=lambda event: event.time)
    times, joints, tip, feet, frames, presses, touches, fastest, stopped = [], [], [], [], [], [], {}, 0.0, np.nan
    for time in _clock(duration, settle, world):
        if times:
            robot.step(wanted(times[-1]), wanted(time))
        while coming and coming[0].time <= time + STEP / 2:
            robot.happen(coming.pop(0).name, world)
        seen = robot.touches()
        _note_touches(touches, seen, world, time)
        presses.append(_pressing(seen, world))
        fastest = max([fastest, *map(world.speed, world.movable)])
        state, position = robot.state()
        if press is not None and np.isnan(stopped) and len(presses) >= LASTING and _sustained(presses[-LASTING:]) > press:
            stopped, coming = time, []
            held = np.concatenate([state, legs(time)])
        times.append(time), joints.append(state), tip.append(position), feet.append(robot.feet_down())
        if fps and len(frames) <= time * fps + 1e-9:
            frames.append(world.photograph(camera))
    times, joints, tip = np.array(times), np.array(joints), np.array(tip)
    planned = arm.fk(motion(np.fmin(np.minimum(times, duration), stopped)))[:, :3, 3]
    goal, verdicts = judge(world, tip[-1], tuple(touches), planned_end=plan.touch if plan.touches else arm.fk(plan.joints[-1])[:3, 3])
    return Execution(
        times,
        joints,
        tuple(plan.names),
        tip,
        np.linalg.norm(tip - planned, axis=1),
        duration,
        *_columns(touches),
        goal,
        verdicts[0].value,
        tuple(v.name for v in verdicts),
        np.array([v.value for v in verdicts], dtype=float),
        np.array([v.bound for v in verdicts], dtype=float),
        np.array([v.met for v in verdicts]),
        tuple(v.said for v in verdicts),
        fastest,
        all(v.met for v in verdicts),
        slipped(np.array(feet)),
        robot.distance(plan.touch, world.in_hand) if plan.touches else np.nan,
        _sustained(presses),
        stopped,
        float(fps),
        np.array(frames) if frames else NO_FILM,
    )


def _legs(arm, motion, duration):
    """time [s] -> the legs' joints (3F,) then, none without legs. Raises NoSolution where they cannot go along."""
    if arm.legs is None:
        return lambda time: np.zeros(0)
    times = np.arange(int(np.ceil(duration / STEP)) + 1) * STEP
    joints = arm.walk(times, motion(np.minimum(times, duration))).joints
    return lambda time: joints[min(round(time / STEP), len(joints) - 1)]


def _clock(duration, settle, world) -> Iterator[float]:
    """Times of the steps [s]: the motion, ``settle`` seconds more, and until things are at rest or patience ends."""
    steps = int(np.ceil((duration + settle) / STEP))
    for k in range(steps + int(PATIENCE / STEP)):
        if k > steps and all(world.speed(name) < AT_REST for name in world.movable):
            return
        yield k * STEP


def judge(world, tip, touched=(), *, planned_end=None) -> tuple[np.ndarray, list[conditions.Verdict]]:
    """By the world's own conditions, from where its things stand now: the goal (3,) [m], see Execution, and the
    verdicts, the hand's first.

    tip (3,) [m]: where the hand is. touched: names of what was touched and not to be. planned_end (3,): what counts as
    the goal's place in a world that has none.
    """
    bounds = conditions.DEFAULTS | (world.spec.get("success") or {})
    goal = goal_point(world)
    place = planned_end if np.isnan(goal).any() else goal
    if place is None:
        raise ValueError(f"world {world.spec['name']} has no goal to judge by")
    hand = conditions.hand(tip, place, bounds["reached_m"])
    return goal, [hand, conditions.contacts(touched, bounds["contacts"]), *conditions.judged(world)]


def goal_point(world) -> np.ndarray:
    """Where the tip is to end (3,) [m], by the goal's object as it stands now; nan in a world without a goal."""
    goal = world.spec.get("goal")
    if not goal:
        return np.full(3, np.nan)
    approach = np.array(goal["approach"], dtype=float)
    return world.pose(goal["object"])[:3, 3] - goal["distance"] * approach / np.linalg.norm(approach)


def film_camera(spec: dict, width: int, height: int) -> Camera:
    """The camera at the world's ``film``: {eye, target, fov_deg}; else beside and above what photographs look at."""
    if not spec.get("view"):
        raise ValueError(
            f"world {spec['name']} says no view with a target to film; give a camera, or fps=0 for no film"
        )
    target = np.array(spec["view"]["target"], dtype=float)
    film = spec.get("film") or {"eye": target + [0.55, -1.6, 1.15], "target": target - [0.3, 0, 0], "fov_deg": 50}
    return Camera.from_fov(look_at(film["eye"], film["target"]), width, height, film["fov_deg"])


def save_video(path, frames: Sequence[np.ndarray], fps: float) -> None:
    """Write frames (F, H, W, 3) uint8 as an H.264 mp4 that browsers play while it loads; whole or not at all."""
    if len(frames) == 0:
        raise ValueError("a video needs at least one frame")
    height, width = (size - size % 2 for size in frames[0].shape[:2])  # yuv420p halves both
    with replacing(path) as temporary:
        with av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"}) as video:
            stream = video.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000), options={"crf": "21", "preset": "medium"})
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for frame in frames:
                picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame[:height, :width]), format="rgb24")
                video.mux(stream.encode(picture))
            video.mux(stream.encode())


def _check(plan, arm, fps, settle, press):
    if not plan.feasible:
        raise ValueError(f"the plan is not feasible, so it is not performed: {plan.sentence}")
    if tuple(plan.names) != tuple(arm.joint_names):
        raise ValueError(f"the plan moves {', '.join(plan.names)}, but this arm has {', '.join(arm.joint_names)}")
    if not (fps >= 0 and settle >= 0):
        raise ValueError(f"fps and settle must not be negative, not {fps} and {settle}")
    if press is not None and not press > 0:
        raise ValueError(f"press is a force in N above 0, or null for none, not {press}")


def _note_touches(touches: dict, seen, world, time) -> None:
    """touches: {body: (link, time, deepest overlap)}, of each body that is not to be touched the first touch and the
    depth of the deepest."""
    names = {body: name for name, body in world.bodies.items()}
    for body, link, depth, _ in seen:
        name = names.get(body, f"body {body}")
        if name not in world.touchable:
            first = touches.setdefault(name, (link, time, depth))
            touches[name] = (*first[:2], max(first[2], depth))


def _pressing(seen, world) -> float:
    """The force [N] on what the robot is to touch and does not hold."""
    meant = {world.bodies[name] for name in world.touchable & world.bodies.keys()} - {*world.in_hand}
    return sum(force for body, _, _, force in seen if body in meant)


def _sustained(forces) -> float:
    """The largest of forces (N,) [N] a step, averaged over PRESSED seconds."""
    steps = min(LASTING, len(forces))
    return float(np.convolve(forces, np.full(steps, 1 / steps), "valid").max())


def _columns(touches: dict):
    links, times, depths = zip(*touches.values()) if touches else ((), (), ())
    return tuple(touches), tuple(links), np.array(times, dtype=float), np.array(depths, dtype=float)
