"""Arm: a robot arm's kinematics and limits, forward and inverse.

Notation
    q      (J,) joint values [rad or m], in the order of ``joint_names``
    base   the root link's frame, which is the world's frame
    tip    the frame of ``tip_link``; ``base_from_tip`` is what fk gives and ik takes

The tree is read from the URDF once and evaluated by compiled functions (kinematics.py); PyBullet only spawns bodies.
"""

import importlib.resources
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml

from robot import kinematics
from robot.kinematics import FIXED, PRISMATIC, REVOLUTE, Tree
from robot.urdf import MOVING, Urdf

DEFAULT_VELOCITY, DEFAULT_ACCELERATION = 1.0, 2.5  # rad/s, rad/s^2 where neither the URDF nor the YAML says anything


class NoSolution(ValueError):
    """No posture reaches what was asked.

    Along a path: ``waypoint``, the index of the first that cannot be had, and ``path`` (waypoint, J), the postures
    before it.
    """

    def __init__(self, message, waypoint=None, path=None):
        super().__init__(message)
        self.waypoint, self.path = waypoint, path


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm standing at the origin of the base frame. Make one with ``load`` or ``from_urdf``.

    lower, upper [rad or m]; velocity [per s]; acceleration [per s^2]; home (J,): comfortable posture, where it starts.
    fingers: {joint name: value when open [m]}; these joints are held there.
    """

    name: str
    urdf: Path
    description: Urdf
    joint_names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    home: np.ndarray
    tip_link: str
    fingers: dict[str, float]

    @classmethod
    def load(cls, name_or_urdf) -> "Arm":
        """By name (conf/robot/arm/<name>.yaml) or from a URDF's path (a path has a folder or ends in .urdf)."""
        text = str(name_or_urdf)
        if text.endswith(".urdf") or "/" in text:
            return cls.from_urdf(text)
        folder = importlib.resources.files("conf") / "robot" / "arm"
        known = sorted(f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml"))
        if text not in known:
            raise ValueError(f"no arm named {text!r}; there are {', '.join(known)}, or give the path of a URDF")
        return cls.from_spec(yaml.safe_load((folder / f"{text}.yaml").read_text()))

    @classmethod
    def from_spec(cls, spec: dict) -> "Arm":
        """From what a YAML file of conf/robot/arm holds: the arguments of ``from_urdf``."""
        return cls.from_urdf(**{key: value for key, value in spec.items() if key != "_target_"})

    @classmethod
    def from_urdf(
        cls,
        urdf,
        tip_link=None,
        home=None,
        name=None,
        lower=None,
        upper=None,
        velocity=None,
        acceleration=None,
        fingers=None,
    ) -> "Arm":
        """Read an arm from a URDF file.

        urdf: path, or "pybullet_data:" and a path in that package. tip_link: the default is the end of the longest
        chain. home (J,) [rad], lower, upper, velocity, acceleration (J,): replace what the URDF says (home: the middle
        of the range nearest zero). fingers: {joint: open value [m]}; other joints off the chain are held at the value
        nearest zero.
        """
        path = _resolve(urdf)
        description = Urdf.load(path)
        tip = tip_link or max(description.links, key=lambda link: len(description.chain(link)))
        if tip not in description.links:
            raise ValueError(f"{path.name} has no link {tip!r}; its links are {', '.join(description.links)}")
        joints = [description.joints[link] for link in description.chain(tip)[1:]]
        joints = [joint for joint in joints if joint.kind in MOVING]
        if not joints:
            raise ValueError(f"{path.name}: no joint moves between {description.chain(tip)[0]} and {tip}")
        count = len(joints)
        low = _vector(lower, [joint.lower for joint in joints], count, "lower")
        high = _vector(upper, [joint.upper for joint in joints], count, "upper")
        speed = [joint.velocity if 0 < joint.velocity < np.inf else DEFAULT_VELOCITY for joint in joints]
        start = _vector(home, np.clip(0.0, low, high), count, "home")
        names = tuple(joint.name for joint in joints)
        outside = [n for n, q, a, b in zip(names, start, low, high) if not a <= q <= b]
        if outside:
            raise ValueError(f"{path.name}: home is outside the limits of {', '.join(outside)}")
        return cls(
            name or path.stem,
            path,
            description,
            names,
            low,
            high,
            _vector(velocity, speed, count, "velocity"),
            _vector(acceleration, [DEFAULT_ACCELERATION] * count, count, "acceleration"),
            start,
            tip,
            dict(fingers or {}),
        )

    @cached_property
    def tree(self) -> Tree:
        """All links of the robot, in the order of ``link_names``."""
        return self._tree(list(self.description.links))

    @cached_property
    def chain(self) -> tuple:
        """The links from the root to the tip, as the compiled functions take them."""
        return self._tree(self.description.chain(self.tip_link)).arrays

    @property
    def link_names(self) -> tuple[str, ...]:
        return tuple(self.description.links)

    def _tree(self, links) -> Tree:
        joints = [self.description.joints.get(link) for link in links]
        kinds = {"fixed": FIXED, "revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}
        return Tree(
            parent=np.array([links.index(j.parent) if j else -1 for j in joints]),
            origin=np.array([j.parent_from_joint if j else np.eye(4) for j in joints]),
            axis=np.array([j.axis if j else np.zeros(3) for j in joints]),
            kind=np.array([kinds[j.kind] if j else FIXED for j in joints]),
            column=np.array(
                [self.joint_names.index(j.name) if j and j.name in self.joint_names else -1 for j in joints]
            ),
            held=np.array([self._held(j) if j else 0.0 for j in joints]),
        )

    def _held(self, joint) -> float:
        return float(self.fingers.get(joint.name, np.clip(0.0, joint.lower, joint.upper)))

    # PyBullet

    @cached_property
    def _numbering(self) -> dict[str, int]:
        """{joint name: PyBullet's index}, from a scratch client."""
        from robot.bullet import connect

        client = connect()
        try:
            body = client.loadURDF(str(self.urdf), useFixedBase=True)
            return {client.getJointInfo(body, i)[1].decode(): i for i in range(client.getNumJoints(body))}
        finally:
            client.disconnect()

    @property
    def joint_indices(self) -> tuple[int, ...]:
        """PyBullet's indices of ``joint_names``."""
        return tuple(self._numbering[name] for name in self.joint_names)

    @property
    def finger_indices(self) -> tuple[int, ...]:
        """PyBullet's indices of the fingers' joints, in the order of ``fingers``."""
        return tuple(self._numbering[name] for name in self.fingers)

    def spawn(self, client) -> int:
        """Put the robot at the origin of the client's world, fixed, at home, fingers open. Returns the body's id."""
        body = client.loadURDF(str(self.urdf), [0, 0, 0], [0, 0, 0, 1], useFixedBase=True)
        values = zip((*self.joint_indices, *self.finger_indices), (*self.home, *self.fingers.values()))
        for index, value in values:
            client.resetJointState(body, index, float(value))
        return body

    # Kinematics

    def fk(self, q) -> np.ndarray:
        """q (J,) or (N, J) -> base_from_tip (4, 4) or (N, 4, 4)."""
        q = self._joints(q)
        poses = kinematics.batch_poses(*self.chain, np.atleast_2d(q))[:, -1]
        return poses[0] if q.ndim == 1 else poses

    def link_poses(self, q) -> np.ndarray:
        """q (N, J) -> base_from_link (N, L, 4, 4) of all links, in the order of ``link_names``."""
        return self.tree.poses(np.atleast_2d(self._joints(q)))

    def jacobian(self, q) -> np.ndarray:
        """Geometric Jacobian (6, J) of the tip in the base frame: linear velocity above angular velocity."""
        q = self._joints(q)
        return kinematics.jacobian(self.chain, q, np.empty((len(self.chain[0]), 4, 4)))

    def within_limits(self, q, tolerance=1e-6) -> np.ndarray:
        """(N, J) -> (N,) bool."""
        q = np.atleast_2d(q)
        return ((q >= self.lower - tolerance) & (q <= self.upper + tolerance)).all(axis=1)

    def ik(
        self,
        base_from_tip,
        start=None,
        position_only=False,
        restarts=40,
        comfort=0.3,
        seed=0,
        position_tolerance=1e-3,
        rotation_tolerance=1e-2,
    ) -> np.ndarray:
        """A posture (J,) whose tip is at ``base_from_tip`` (4, 4), within the limits; checked by forward kinematics.

        start (J,): where to begin (home); the other attempts begin at home and at ``restarts`` random postures
        (``seed``). position_only: any orientation will do. comfort: share of the way towards home taken in the null
        space per step, 0 for none. Raises NoSolution, saying how far the best attempt came and which limits held it.
        """
        target = _pose(base_from_tip)
        starts = np.vstack(
            [self.home if start is None else self._joints(start), self.home, self.random(restarts, seed)]
        )
        rows = 3 if position_only else 6
        q, position, rotation = kinematics.solve(
            self.chain,
            self.lower,
            self.upper,
            target,
            starts,
            rows,
            80,
            position_tolerance / 10,
            rotation_tolerance / 10,
        )
        if position > position_tolerance or rotation > rotation_tolerance:
            raise NoSolution(self._why("the pose" if rows == 6 else "the position", q, position, rotation))
        if comfort > 0:
            q = self._comfortable(target, q, comfort, rows, position_tolerance, rotation_tolerance)
        return q

    def _comfortable(self, target, q, comfort, rows, position_tolerance, rotation_tolerance):
        """q moved towards home within the null space, or q itself where that breaks the target."""
        moved = q.copy()
        position, rotation = kinematics.settle(
            self.chain, self.lower, self.upper, target, moved, self.home.copy(), float(comfort), rows, 20, 1e-6
        )
        return moved if position < position_tolerance / 10 and rotation < rotation_tolerance / 10 else q

    def follow(
        self,
        targets,
        start=None,
        rest=None,
        gain=0.5,
        position_tolerance=1e-3,
        rotation_tolerance=1e-2,
        largest_step=0.2,
    ) -> np.ndarray:
        """Postures (T, J) along points (T, 3) or poses (T, 4, 4), continuous from ``start`` (J,) (home), within the
        limits.

        rest (J,) or (T, J): each posture is the one nearest to it among those on the path (the default is home);
        gain: share of that distance closed per iteration. largest_step: between neighbours [rad].
        Raises NoSolution with the index of the first waypoint that cannot be had.
        """
        poses, rows = path_poses(targets)
        start = self._joints(self.home if start is None else start)
        rests = np.broadcast_to(self.home if rest is None else rest, (len(poses), len(start)))
        path, position, rotation = kinematics.track(
            self.chain,
            self.lower,
            self.upper,
            poses,
            np.array(rests, dtype=float, order="C"),
            start.copy(),
            float(gain),
            rows,
            1e-5,
        )
        missed = (position > position_tolerance) | (rotation > rotation_tolerance)
        steps = np.abs(np.diff(np.vstack([start, path]), axis=0)).max(axis=1)
        bad = np.flatnonzero(missed | (steps > largest_step))
        if len(bad) == 0:
            return path
        k = int(bad[0])
        if missed[k]:
            raise NoSolution(
                self._why(f"waypoint {k + 1} of {len(path)}", path[k], position[k], rotation[k]), k, path[:k]
            )
        joint = self.joint_names[int(np.abs(path[k] - (path[k - 1] if k else start)).argmax())]
        raise NoSolution(
            f"at waypoint {k + 1} of {len(path)} {joint} would jump by {steps[k]:.2f} rad "
            f"(at most {largest_step:.2f} is continuous)",
            k,
            path[:k],
        )

    def random(self, count, seed) -> np.ndarray:
        """(count, J) postures, uniform within the limits (within a turn where there are none)."""
        low, high = np.maximum(self.lower, -np.pi * 2), np.minimum(self.upper, np.pi * 2)
        return np.random.default_rng(seed).uniform(low, high, (count, len(low)))

    def limits_reached(self, q) -> list[str]:
        """The joints that stand at a limit, in words."""
        words = [
            (self.joint_names[j], side)
            for j in range(len(q))
            for side, bound in (("lower", self.lower[j]), ("upper", self.upper[j]))
            if abs(q[j] - bound) < 1e-4
        ]
        return [f"{name} at its {side} limit" for name, side in words]

    def _why(self, what, q, position, rotation) -> str:
        turned = f" and {np.degrees(rotation):.1f} degrees" if rotation > 0 else ""
        limits = self.limits_reached(q)
        cause = f"with {' and '.join(limits)}" if limits else "with no joint at a limit: the arm is stretched or folded"
        return f"{self.name} cannot reach {what}: the best posture stops {1e3 * position:.1f} mm{turned} short, {cause}"

    def _joints(self, q) -> np.ndarray:
        q = np.array(q, dtype=float, order="C")  # writable and contiguous: one compiled version serves all
        if q.shape[-1:] != (len(self.joint_names),) or q.ndim > 2 or not np.isfinite(q).all():
            raise ValueError(
                f"{self.name} takes {len(self.joint_names)} finite joint values, not an array of shape {q.shape}"
            )
        return q


def path_poses(targets) -> tuple[np.ndarray, int]:
    """Points (T, 3) or poses (T, 4, 4) -> poses (T, 4, 4) and the rows of the error that count, 3 or 6."""
    targets = np.asarray(targets, dtype=float)
    if not np.isfinite(targets).all():
        raise ValueError("a path must consist of finite numbers")
    if targets.ndim == 3 and targets.shape[1:] == (4, 4):
        return np.ascontiguousarray(targets), 6
    if targets.ndim != 2 or targets.shape[1] != 3:
        raise ValueError(f"a path is points (T, 3) or poses (T, 4, 4), not {targets.shape}")
    poses = np.tile(np.eye(4), (len(targets), 1, 1))
    poses[:, :3, 3] = targets
    return poses, 3


def _pose(base_from_tip) -> np.ndarray:
    pose = np.ascontiguousarray(base_from_tip, dtype=float)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError(f"a pose is a finite (4, 4) matrix, not {pose.shape}")
    if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4):
        raise ValueError("the rotation of a pose must be orthonormal")
    return pose


def _resolve(urdf) -> Path:
    text = str(urdf)
    if not text.startswith("pybullet_data:"):
        return Path(text)
    return Path(str(importlib.resources.files("pybullet_data"))) / text.removeprefix("pybullet_data:")


def _vector(given, otherwise, count, what) -> np.ndarray:
    values = np.array(otherwise if given is None else given, dtype=float)
    if values.shape != (count,) or np.isnan(values).any():
        raise ValueError(f"{what} must be {count} numbers, one for each joint; got {values.tolist()}")
    values.setflags(write=False)
    return values
