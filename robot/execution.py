"""perform: PyBullet follows a plan under motor control; what happened is recorded, filmed, and judged.

Every simulated step of 1/240 s the motors of all joints get where the plan is now and how fast it moves until the next
step (velocity feed-forward), within the efforts that the URDF allows; gravity acts. The judge reads the simulator's
state and the world's own conditions, never the plan.

    goal = p_object - distance * approach / |approach|      the point before the goal's object, where that stands now
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from zipfile import BadZipFile

import av
import numpy as np

from robot.bullet import pybullet
from robot.timing import motion_spline
from scene.camera import Camera, look_at
from scene.files import replacing

STEP = 1 / 240  # s, PyBullet's own
TOUCHING = 1e-4  # m; contacts further apart than this are warnings of Bullet's margin, not touches
POSITION_GAIN = 0.3  # share of the position error that is corrected in a step
NO_FILM = np.zeros((0, 0, 0, 3), np.uint8)
UNLIMITED = 1e3  # N m or N, where the URDF allows no effort at all


@dataclass(frozen=True, eq=False)
class Execution:
    """What the robot did, a row for each of N control steps; the time after the plan's end is for settling.

    times (N,) [s]. joints (N, J) [rad]. names: of the joints. tip (N, 3) [m]. tip_error (N,) [m]: against the planned
    tip at the same time. duration [s]: of the plan. touched: bodies that the robot touched, in that order, with
    touched_by, the link that did, touched_at (C,) [s] and touch_depth (C,) [m], the deepest overlap. goal (3,) [m]:
    where the tip was to end (nan in a world without a goal). final_error [m]: from there, or else from the plan's
    end. success: by the world's conditions. frames (F, H, W, 3) uint8 at ``fps``: the film, not kept by ``save``.
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
    success: bool
    fps: float
    frames: np.ndarray

    @property
    def metrics(self) -> dict:
        """Numbers for metrics.json; the tracking error is of the motion, without the settling."""
        error = 1e3 * self.tip_error[self.times <= self.duration + STEP / 2]
        return {
            "tracking_error_mm": float(np.sqrt(np.mean(error**2))),
            "tracking_error_max_mm": float(error.max()),
            "final_error_mm": 1e3 * float(self.final_error),
            "contacts": len(self.touched),
            "success": bool(self.success),
        }

    @property
    def sentence(self) -> str:
        """What came of it, in one line."""
        numbers = self.metrics
        touches = [
            f"{link} touched {body} after {at:.2f} s ({1e3 * depth:.1f} mm deep)"
            for body, link, at, depth in zip(self.touched, self.touched_by, self.touched_at, self.touch_depth)
        ]
        return (
            f"{'success' if self.success else 'failure'}: the hand ended {numbers['final_error_mm']:.1f} mm from where "
            f"it was to go and followed the plan within {numbers['tracking_error_mm']:.2f} mm RMS, "
            f"{numbers['tracking_error_max_mm']:.2f} mm at most; "
            f"{'; '.join(touches) if touches else 'nothing was touched'}"
        )

    def save(self, path) -> None:
        """Write all but the film to an npz file, whole or not at all."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "frames"}
        words = {name: np.array(values[name], dtype=str) for name in ("names", "touched", "touched_by")}
        with replacing(path) as temporary:
            np.savez(temporary, **values | words)

    @classmethod
    def load(cls, path) -> "Execution":
        """Read what ``save`` wrote, with an empty film. Raises FileNotFoundError, or ValueError for any other file."""
        if not Path(path).is_file():
            raise FileNotFoundError(f"no execution file {path}")
        try:
            with np.load(path, allow_pickle=False) as file:
                values = {f.name: file[f.name] for f in fields(cls) if f.name != "frames"}
        except (ValueError, KeyError, EOFError, OSError, BadZipFile) as error:
            raise ValueError(f"{path} is not an execution file ({error}); robot.execute writes one") from None
        words = {name: tuple(values[name].tolist()) for name in ("names", "touched", "touched_by")}
        numbers = {name: values[name].item() for name in ("duration", "final_error", "success", "fps")}
        return cls(**values | words | numbers, frames=NO_FILM)


def perform(plan, arm, world, *, camera=None, fps=12.5, width=480, height=360, settle=0.6) -> Execution:
    """The arm follows the plan among the bodies of the world, which changes by it.

    plan: Plan. arm: Arm. world: World, without a robot in it yet. camera: Camera that films; None stands it where the
    world's ``film`` says, ``width`` x ``height`` [px]. fps: frames a second; 0 films nothing. settle [s]: how long the
    last posture is held before the judge looks. Raises ValueError for a plan that is not feasible or of another arm.
    """
    _check(plan, arm, fps, settle)
    camera = film_camera(world.spec, width, height) if camera is None and fps else camera
    robot = _Robot(arm, world.client, plan.joints[0])
    motion = motion_spline(plan.times, plan.joints)
    duration = float(plan.times[-1])
    times = STEP * np.arange(int(np.ceil((duration + settle) / STEP)) + 1)
    wanted = motion(np.minimum(times, duration))
    joints, tip, frames, touches = [], [], [], {}
    for k, time in enumerate(times):
        if k:
            robot.step(wanted[k - 1], wanted[k])
        _note_touches(touches, robot.touches(), world, time)
        state, position = robot.state()
        joints.append(state)
        tip.append(position)
        if fps and len(frames) <= time * fps + 1e-9:
            frames.append(world.photograph(camera))
    joints, tip = np.array(joints), np.array(tip)
    tip_error = np.linalg.norm(tip - arm.fk(wanted)[:, :3, 3], axis=1)
    verdict = judge(world, tip[-1], len(touches), planned_end=arm.fk(wanted[-1])[:3, 3])
    film = np.array(frames) if frames else NO_FILM
    return Execution(
        times,
        joints,
        tuple(plan.names),
        tip,
        tip_error,
        duration,
        *_columns(touches),
        **verdict,
        fps=float(fps),
        frames=film,
    )


def judge(world, tip, contacts: int, *, planned_end=None) -> dict:
    """By the world's own conditions, from where its things stand now: {goal, final_error, success}, see Execution.

    tip (3,) [m]: where the hand is. contacts: how many bodies were touched. planned_end (3,): what counts as the goal's
    place in a world that has none.
    """
    conditions = {"reached_m": 0.05, "contacts": 0} | (world.spec.get("success") or {})
    goal = goal_point(world)
    place = planned_end if np.isnan(goal).any() else goal
    if place is None:
        raise ValueError(f"world {world.spec['name']} has no goal to judge by")
    final_error = float(np.linalg.norm(np.asarray(tip) - place))
    success = final_error <= conditions["reached_m"] and contacts <= conditions["contacts"]
    return {"goal": goal, "final_error": final_error, "success": bool(success)}


def goal_point(world) -> np.ndarray:
    """Where the tip is to end (3,) [m], by the goal's object as it stands now; nan in a world without a goal."""
    goal = world.spec.get("goal")
    if not goal:
        return np.full(3, np.nan)
    position, _ = world.client.getBasePositionAndOrientation(world.bodies[goal["object"]])
    approach = np.array(goal["approach"], dtype=float)
    return np.array(position) - goal["distance"] * approach / np.linalg.norm(approach)


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


class _Robot:
    """The arm's body in the world's client, at rest in a posture; its state is read and written here only."""

    def __init__(self, arm, client, start):
        self.client, self.body = client, arm.spawn(client)
        self.joints = list(arm.joint_indices)
        self.fingers, self.open = list(arm.finger_indices), list(arm.fingers.values())
        for joint, value in zip(self.joints, start):
            client.resetJointState(self.body, joint, float(value))
        info = [client.getJointInfo(self.body, index) for index in range(client.getNumJoints(self.body))]
        self.links = [entry[12].decode() for entry in info]
        self.tip = self.links.index(arm.tip_link)
        self.effort = {index: entry[10] or UNLIMITED for index, entry in enumerate(info)}
        client.setTimeStep(STEP)

    def step(self, now, then) -> None:
        """One step of the motors from where the plan is now (J,) to where it is ``then`` (J,)."""
        speeds = (np.asarray(then) - now) / STEP
        self._drive(self.joints, now, speeds)
        self._drive(self.fingers, self.open, np.zeros(len(self.fingers)))
        self.client.stepSimulation()

    def _drive(self, joints, positions, speeds) -> None:
        for joint, position, speed in zip(joints, positions, speeds):
            self.client.setJointMotorControl2(
                self.body, joint, pybullet.POSITION_CONTROL,
                targetPosition=float(position), targetVelocity=float(speed),
                positionGain=POSITION_GAIN, velocityGain=1.0, force=self.effort[joint],
            )  # fmt: skip

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint values (J,) and the tip's place (3,) [m]."""
        joints = [state[0] for state in self.client.getJointStates(self.body, self.joints)]
        return np.array(joints), np.array(
            self.client.getLinkState(self.body, self.tip, computeForwardKinematics=True)[4]
        )

    def touches(self) -> list[tuple[int, str, float]]:
        """(body, link, overlap [m]) of what the robot touches now; its fixed foot may stand on something."""
        self.client.performCollisionDetection()
        points = self.client.getContactPoints(bodyA=self.body)
        return [(p[2], self.links[p[3]], -p[8]) for p in points if p[2] != self.body and p[3] >= 0 and p[8] < TOUCHING]


def _check(plan, arm, fps, settle):
    if not plan.feasible:
        raise ValueError(f"the plan is not feasible, so it is not performed: {plan.sentence}")
    if tuple(plan.names) != tuple(arm.joint_names):
        raise ValueError(f"the plan moves {', '.join(plan.names)}, but this arm has {', '.join(arm.joint_names)}")
    if not (fps >= 0 and settle >= 0):
        raise ValueError(f"fps and settle must not be negative, not {fps} and {settle}")


def _note_touches(touches: dict, seen, world, time) -> None:
    """touches: {body: (link, time, deepest overlap)}, of each body the first touch and the depth of the deepest."""
    names = {body: name for name, body in world.bodies.items()}
    for body, link, depth in seen:
        first = touches.setdefault(names.get(body, f"body {body}"), (link, time, depth))
        touches[names.get(body, f"body {body}")] = (*first[:2], max(first[2], depth))


def _columns(touches: dict):
    links, times, depths = zip(*touches.values()) if touches else ((), (), ())
    return tuple(touches), tuple(links), np.array(times, dtype=float), np.array(depths, dtype=float)
