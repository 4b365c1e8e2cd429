"""Arm: a robot arm's kinematics and limits, forward and inverse; on a walking trunk too.

Notation
    q      (J,) joint values [rad or m], in the order of ``joint_names``
    base   the root link's frame, which is the world's frame
    tip    the frame of ``tip_link``, at the hand's ``contact``; ``base_from_tip`` is what fk gives and ik takes

The tree is read from the URDF once and evaluated by compiled functions (kinematics.py); PyBullet only spawns bodies.
"""

import importlib.resources
import inspect
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from robot import inverse, kinematics
from robot.gait import Walk, walk
from robot.inverse import NoSolution, Tool
from robot.kinematics import FIXED, POSE, POSITION, PRISMATIC, REVOLUTE, Tree
from robot.legs import Legs
from robot.urdf import MOVING, Urdf
from scene.files import read_yaml

PACKAGES = ("pybullet_data", "robot")  # that a URDF's path may start in
DEFAULT_VELOCITY, DEFAULT_ACCELERATION = 1.0, 2.5  # rad/s, rad/s^2 where neither the URDF nor the YAML says anything


@dataclass(frozen=True, eq=False)
class Gripper:
    """joints: their names. open, closed (G,): their values [m or rad]. rest (3,): in the tip's frame, from a finger that does
    not move to what lies on it, of length 1; 0 where both fingers move."""

    joints: tuple[str, ...]
    open: np.ndarray
    closed: np.ndarray
    rest: np.ndarray


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm standing at the origin of the base frame. Make one with ``load`` or ``from_urdf``.

    lower, upper [rad or m]; velocity [per s]; acceleration [per s^2]; home (J,): comfortable posture, where it starts.
    gripper: its joints are held open where kinematics and collision are concerned. legs: of a robot that walks; the first
    joints are then its trunk's place. contact (3,) [m]: in the frame of ``tip_link``, the point that follows paths and is the tip of all
    that is said here; where a motion touches, the hand's end (contact.py).
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
    gripper: Gripper
    legs: Legs | None = None
    contact: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def load(cls, name_or_path) -> "Arm":
        """By name (conf/robot/arm/<name>.yaml), or from a path of a YAML file or of a URDF (with a folder or an ending).

        A YAML file holds the arguments of ``from_urdf``; only ``urdf`` must be there, relative to the file's folder.
        """
        text = str(name_or_path)
        if text.endswith((".yaml", ".yml")):
            return cls.from_spec(_read(Path(text)), Path(text).parent)
        if text.endswith(".urdf") or "/" in text:
            return cls.from_urdf(text)
        folder = importlib.resources.files("conf") / "robot" / "arm"
        specs = {f.name.removesuffix(".yaml"): _read(f) for f in folder.iterdir() if f.name.endswith(".yaml")}
        known = sorted(name for name, spec in specs.items() if "urdf" in spec)
        if text not in known:
            others = "or give the path of a URDF or of a YAML file"
            raise ValueError(f"no arm named {text!r}; there are {', '.join(known)}, {others}")
        return cls.from_spec(specs[text])

    @classmethod
    def from_spec(cls, spec: dict, folder: Path = Path()) -> "Arm":
        """From what a YAML file of an arm holds: the arguments of ``from_urdf``. folder: where its path starts."""
        settings = {key: value for key, value in spec.items() if key != "_target_"}
        known = inspect.signature(cls.from_urdf).parameters
        unknown = [key for key in settings if key not in known]
        if unknown or "urdf" not in settings:
            wrong = f"unknown {', '.join(unknown)}" if unknown else "no urdf"
            raise ValueError(f"an arm's file has {wrong}; its keys are {', '.join(known)}")
        urdf = str(settings["urdf"])
        return cls.from_urdf(**settings | {"urdf": urdf if urdf.partition(":")[0] in PACKAGES else folder / urdf})

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
        gripper=None,
        legs=None,
    ) -> "Arm":
        """Read an arm from a URDF file.

        urdf: path, or "pybullet_data:" or "robot:" and a path there. tip_link: the default is the end of the longest
        chain. home (J,) [rad], lower, upper, velocity, acceleration (J,): replace what the URDF says (home: the middle
        of the range nearest zero). gripper: {joints: names, open: values, closed: values} [m or rad] and perhaps
        rest, see Gripper; other joints off the chain are held at the value nearest zero. legs: {feet: names of links, ground: height of what they stand on [m],
        room: boxes}, see Legs; what moves between the root and the trunk are then joints of the arm too. Raises FileNotFoundError, or ValueError that says what is wrong.
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
            _gripper(gripper, description, names, path.name),
            Legs.from_urdf(description, **legs) if legs else None,
        )

    @cached_property
    def tree(self) -> Tree:
        """All links of the robot, in the order of ``link_names``."""
        return self._tree(list(self.description.links))

    @cached_property
    def chain(self) -> tuple:
        """The links from the root to the tip, as the compiled functions take them."""
        tree = self._tree(self.description.chain(self.tip_link))
        return (tree.extended(self.contact) if self.contact.any() else tree).arrays

    @property
    def beside_hand(self) -> tuple[str, ...]:
        """The links that can move against the tip: all but the hand's."""
        rigid = self.tree.rigid_groups
        return tuple(name for name, group in zip(self.link_names, rigid) if group != rigid[self.link_names.index(self.tip_link)])

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
        opened = dict(zip(self.gripper.joints, self.gripper.open))
        return float(opened.get(joint.name, np.clip(0.0, joint.lower, joint.upper)))

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
    def gripper_indices(self) -> tuple[int, ...]:
        """PyBullet's indices of the gripper's joints."""
        return tuple(self._numbering[name] for name in self.gripper.joints)

    @property
    def leg_indices(self) -> tuple[int, ...]:
        """PyBullet's indices of the legs' joints."""
        return tuple(self._numbering[name] for name in self.legs.joints) if self.legs else ()

    def spawn(self, client) -> int:
        """Put the robot at the origin of the client's world, fixed, at home, its gripper open. Returns the body's id."""
        body = client.loadURDF(str(self.urdf), [0, 0, 0], [0, 0, 0, 1], useFixedBase=True)
        values = zip((*self.joint_indices, *self.gripper_indices), (*self.home, *self.gripper.open))
        for index, value in values:
            client.resetJointState(body, index, float(value))
        for index, value in zip(self.leg_indices, self.walk([0.0], self.home[None]).joints[0] if self.legs else ()):
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

    def walk(self, times, q) -> Walk:
        """How the legs go along with q (T, J) at times (T,) [s]. Raises NoSolution where they cannot."""
        return walk(self.legs, times, self.link_poses(q)[:, self.link_names.index(self.legs.trunk)])

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
        start = self.home if start is None else self._joints(start)
        rows = POSITION if position_only else POSE
        tolerances = position_tolerance, rotation_tolerance
        return inverse.solve(self, base_from_tip, start, rows, restarts, comfort, seed, *tolerances)

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
        poses, rows = inverse.path_poses(targets)
        start = self._joints(self.home if start is None else start)
        rest = self.home if rest is None else rest
        tolerances = position_tolerance, rotation_tolerance
        return inverse.follow(self, poses, rows, start, rest, gain, *tolerances, largest_step)

    def along(self, points, tool=Tool(), start=None, seed=0) -> np.ndarray:
        """Postures (T, J) along points (T, 3) [m], continuous, within the limits, on the best branch over the whole path.

        tool: how the hand is turned. start (J,): the posture to come from; None: any. Raises NoSolution with the first
        waypoint that cannot be had on the branch that comes farthest.
        """
        start = None if start is None else self._joints(start)
        return inverse.choose(self, *tool.poses(points), start, tool.tolerance, seed)

    def still(self, q) -> "Arm":
        """A robot with legs whose base stays where q (J,) has it; an arm as it is."""
        fixed = lambda limits: np.append(q[:3], limits[3:])
        return self if self.legs is None else replace(self, lower=fixed(self.lower), upper=fixed(self.upper))

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

    def _joints(self, q) -> np.ndarray:
        q = np.array(q, dtype=float, order="C")  # writable and contiguous: one compiled version serves all
        if q.shape[-1:] != (len(self.joint_names),) or q.ndim > 2 or not np.isfinite(q).all():
            raise ValueError(
                f"{self.name} takes {len(self.joint_names)} finite joint values, not an array of shape {q.shape}"
            )
        return q


def _read(file) -> dict:
    """What a YAML file holds. Raises FileNotFoundError, or ValueError for what is no mapping."""
    spec = read_yaml(file, f"no arm file {file}")
    if not isinstance(spec, dict):
        raise ValueError(f"{file} must hold an arm's settings, such as urdf: my_arm.urdf")
    return spec


def _resolve(urdf) -> Path:
    package, _, path = str(urdf).partition(":")
    return Path(str(importlib.resources.files(package))) / path if package in PACKAGES else Path(urdf)


def _gripper(given, description, arm_joints, file) -> Gripper:
    given = given or {"joints": (), "open": (), "closed": ()}
    if not {"joints", "open", "closed"} <= set(given) <= {"joints", "open", "closed", "rest"}:
        raise ValueError(f"{file}: a gripper has joints, open and closed, and perhaps rest, not {', '.join(given)}")
    moving = [joint.name for joint in description.joints.values() if joint.kind in MOVING]
    known = [name for name in moving if name not in arm_joints]
    for name in given["joints"]:
        if name not in known:
            raise ValueError(f"{file}: the gripper's joint {name} is none of {', '.join(known) or 'no joint'}")
    values = (_vector(given[key], None, len(given["joints"]), f"the gripper's {key}") for key in ("open", "closed"))
    return Gripper(tuple(given["joints"]), *values, _vector(given.get("rest"), [0, 0, 0], 3, "the gripper's rest"))


def _vector(given, otherwise, count, what) -> np.ndarray:
    given = otherwise if given is None else given
    try:
        values = np.atleast_1d(np.array(given, dtype=float))
    except (TypeError, ValueError):
        values = np.full(0, np.nan)  # words, or lists of several lengths
    if values.shape != (count,) or np.isnan(values).any():
        raise ValueError(f"{what} must be {count} numbers, one for each joint; got {given if isinstance(given, list | str) else np.asarray(given).tolist()}")
    values.setflags(write=False)
    return values
