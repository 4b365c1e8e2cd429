"""Inverse kinematics: postures whose tip is where it is asked to be, within the limits, checked by forward kinematics.

    solve     one target: damped least squares from several starts (kinematics.py), then to comfort in the null space
    follow    a path, from a given posture on; each posture is the one nearest to a posture at rest
    choose    a path, over all ways to hold the arm along it: many branches are followed at once, a stretch of the path
              at a time and drawn to several sides, and those of least cost that differ are kept (dynamic programming,
              with a beam in place of all states); the smoothest and most comfortable whole path is taken

How the hand is turned is asked for by a Tool: free, kept, pointed along an axis, or along the path's tangent.
"""

from dataclasses import dataclass

import numpy as np

from robot import kinematics
from robot.kinematics import POINTED, POSE, POSITION

POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-3, 1e-2  # m, rad
LARGEST_STEP = 0.2  # rad between neighbours of a path; more is a jump to another branch
STRETCHES, BEGINNINGS, BEAM = 8, 24, 10  # of a path; branches at its first waypoint; branches kept after each stretch
CHORD = 0.02  # m
APART = 0.3  # rad: postures nearer to each other than this are of one branch
TOOLS = ("free", "kept", "pointed", "tangent")


class NoSolution(ValueError):
    """No posture reaches what was asked; ``posture`` (J,) comes nearest.

    Along a path: ``waypoint``, the index of the first that cannot be had, ``path`` (waypoint, J), the postures before
    it, and ``posture`` (J,), the one that comes nearest to it, None where it could be had but for a jump.
    """

    def __init__(self, message, waypoint=None, path=None, posture=None):
        super().__init__(message)
        self.waypoint, self.path, self.posture = waypoint, path, posture


@dataclass(frozen=True, eq=False)
class Tool:
    """How the hand is turned along a path of points.

    kind: "free"; "kept", as ``rotation`` (3, 3); "pointed", its z axis along ``axis`` (3,), turning about it being
    free; "tangent", its z axis along the path. tolerance [rad]: by which it may be turned away from that.
    """

    kind: str = "free"
    rotation: np.ndarray | None = None
    axis: np.ndarray | None = None
    tolerance: float = 0.0

    def __post_init__(self):
        if self.kind not in TOOLS:
            raise ValueError(f"a tool is {', '.join(TOOLS)}, not {self.kind!r}")
        needed = {"kept": "rotation", "pointed": "axis"}.get(self.kind)
        if needed and getattr(self, needed) is None:
            raise ValueError(f"a tool that is {self.kind} needs its {needed}")
        if not 0 <= self.tolerance < np.pi:
            raise ValueError(f"a tool's tolerance is an angle from 0 to pi, not {self.tolerance}")

    def __str__(self):
        axis = f" along ({', '.join(f'{x:.2f}' for x in self.axis)})" if self.kind == "pointed" else ""
        return f"{self.kind}{' to the path' * (self.kind == 'tangent')}{axis}"

    def poses(self, points) -> tuple[np.ndarray, int]:
        """Points (T, 3) [m] -> poses (T, 4, 4) and which of their rows count."""
        poses, _ = path_poses(points)
        if self.kind == "kept":
            poses[:, :3, :3] = self.rotation
            return poses, POSE
        if self.kind == "free":
            return poses, POSITION
        tangent = self.kind == "tangent"
        ahead = _ahead(poses[:, :3, 3]) if tangent else np.broadcast_to(self.axis, (len(poses), 3))
        for pose, z in zip(poses, directions(ahead)):
            pose[:3, :3] = _with_z(z)
        return poses, POINTED


def _ahead(points) -> np.ndarray:
    """(T, 3) along a path (T, 3): chords from CHORD [m] of the way before to CHORD after, so that what wavers by a
    millimetre does not turn the hand."""
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    last = len(points) - 1
    before = np.searchsorted(way, way - CHORD, side="right") - 1
    after = np.minimum(np.searchsorted(way, way + CHORD), last)
    return points[np.maximum(after, np.arange(last + 1))] - points[np.clip(before, 0, None)]


def tool_of(orientation, tolerance: float, present) -> Tool:
    """The Tool that a setting means: None or "free", "keep" (as the hand is turned at ``present`` (3, 3)), "down",
    "tangent", or an axis [x, y, z] that it points along. Raises ValueError for anything else."""
    if orientation is None or isinstance(orientation, str):
        kinds = {
            None: {}, "free": {}, "tangent": {"kind": "tangent"}, "keep": {"kind": "kept", "rotation": np.asarray(present)},
            "down": {"kind": "pointed", "axis": np.array([0.0, 0.0, -1.0])},
        }  # fmt: skip
        if orientation not in kinds:
            raise ValueError(f"the hand's orientation is free, keep, down, tangent or an axis [x, y, z], not {orientation!r}")
        return Tool(**kinds[orientation], tolerance=tolerance)
    axis = np.array(orientation, dtype=float)
    if axis.shape != (3,) or not np.isfinite(axis).all() or np.linalg.norm(axis) < 1e-9:
        raise ValueError(f"the axis that the hand points along is three numbers with a direction, not {orientation}")
    return Tool("pointed", axis=axis, tolerance=tolerance)


def directions(ahead) -> np.ndarray:
    """Unit vectors (T, 3); where one has no length it is that of its nearest neighbour."""
    length = np.linalg.norm(ahead, axis=1)
    long = np.flatnonzero(length > 1e-9)
    if len(long) == 0:
        raise ValueError("the hand cannot point along what has no direction")
    nearest = long[np.abs(long[:, None] - np.arange(len(ahead))).argmin(axis=0)]
    return ahead[nearest] / length[nearest, None]


def _with_z(z) -> np.ndarray:
    """A rotation (3, 3) whose third column is the unit vector z; the others are arbitrary."""
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def solve(arm, base_from_tip, start, rows, restarts, comfort, seed, position_tolerance, rotation_tolerance) -> np.ndarray:
    """See Arm.ik."""
    target = _pose(base_from_tip)
    starts = np.vstack([start, arm.home, arm.random(restarts, seed)])
    close = position_tolerance / 10, rotation_tolerance / 10
    q, position, rotation = kinematics.solve(arm.chain, arm.lower, arm.upper, target, starts, rows, 0.0, 80, *close)
    if position > position_tolerance or rotation > rotation_tolerance:
        raise NoSolution(_why(arm, "the position" if rows == POSITION else "the pose", q, position, rotation), posture=q)
    return _comfortable(arm, target, q, comfort, rows, close) if comfort > 0 else q


def _comfortable(arm, target, q, comfort, rows, close):
    """q moved towards home within the null space, or q itself where that breaks the target."""
    moved = q.copy()
    position, rotation = kinematics.settle(
        arm.chain, arm.lower, arm.upper, target, moved, arm.home.copy(), float(comfort), rows, 0.0, 20, 1e-6
    )
    return moved if position < close[0] and rotation < close[1] else q


def follow(arm, poses, rows, start, rest, gain, position_tolerance, rotation_tolerance, largest_step, slack=0.0) -> np.ndarray:
    """See Arm.follow; poses (T, 4, 4) of which ``rows`` count, rest (J,) or (T, J)."""
    path, position, rotation = _track(arm, poses, rows, slack, start, rest, gain)
    missed = (position > position_tolerance) | (rotation > rotation_tolerance)
    steps = np.abs(np.diff(np.vstack([start, path]), axis=0)).max(axis=1)
    bad = np.flatnonzero(missed | (steps > largest_step))
    if len(bad) == 0:
        return path
    k = int(bad[0])
    if missed[k]:
        what = f"waypoint {k + 1} of {len(path)}"
        raise NoSolution(_why(arm, what, path[k], position[k], rotation[k]), k, path[:k], path[k])
    joint = arm.joint_names[int(np.abs(path[k] - (path[k - 1] if k else start)).argmax())]
    raise NoSolution(
        f"at waypoint {k + 1} of {len(path)} {joint} would jump by {steps[k]:.2f} rad "
        f"(at most {largest_step:.2f} is continuous)",
        k,
        path[:k],
    )


def _track(arm, poses, rows, slack, start, rest, gain):
    """The postures (T, J), and the position [m] and rotation errors [rad] (T,) that are left."""
    rests = np.array(np.broadcast_to(rest, (len(poses), len(start))), order="C")
    limits = arm.lower, arm.upper
    poses = np.ascontiguousarray(poses)  # for a slice of others it would be compiled anew, which takes seconds
    return kinematics.track(arm.chain, *limits, poses, rests, start.copy(), float(gain), rows, float(slack), 1e-5)


def choose(arm, poses, rows, start=None, slack=0.0, seed=0) -> np.ndarray:
    """Postures (T, J) along poses (T, 4, 4), of which ``rows`` count, on the best branch over the whole path.

    start (J,): where the path begins; where None, any posture at its first waypoint. Raises NoSolution of the branch
    that comes farthest.
    """
    begun = [start] if start is not None else branches(arm, poses[0], rows, slack, seed)
    if not begun:
        why = f"{arm.name} reaches the first waypoint in no posture that was tried"
        raise NoSolution(why, 0, np.zeros((0, len(arm.home))))
    rng, done = np.random.default_rng(seed), 0
    kept = [np.array(q)[None] for q in begun]  # each with its beginning in front, which is dropped at the end
    for stretch in np.array_split(poses, min(STRETCHES, len(poses))):
        sides = [arm.home, *arm.random(3, rng)]
        longer, failure = [], None
        for path in kept:
            for side in (path[-1], *sides):
                try:
                    longer.append(np.vstack([path, _drawn(arm, stretch, rows, slack, path[-1], side)]))
                except NoSolution as error:
                    failure = error if failure is None or error.waypoint > failure.waypoint else failure
        if not longer:
            where = f"(waypoint {done + failure.waypoint + 1} of {len(poses)} of the whole path)"
            raise NoSolution(f"{failure} {where}", done + failure.waypoint, kept[0][1:], failure.posture)
        kept, done = _different(sorted(longer, key=lambda path: discomfort(arm, path)), BEAM), done + len(stretch)
    return kept[0][1:]


def _drawn(arm, poses, rows, slack, q, side) -> np.ndarray:
    """From posture q on along poses, drawn towards the posture ``side`` at a pace that is no jump."""
    share = min(1.0, len(poses) * LARGEST_STEP / 4 / max(np.abs(side - q).max(), 1e-9))
    rest = q + share * np.linspace(0, 1, len(poses) + 1)[1:, None] * (side - q)
    return follow(arm, poses, rows, q, rest, 0.5, POSITION_TOLERANCE, ROTATION_TOLERANCE, LARGEST_STEP, slack)


def _different(paths, count) -> list[np.ndarray]:
    """The first ``count`` paths that end farther than APART from those before."""
    kept = []
    for path in paths:
        if len(kept) < count and all(np.abs(path[-1] - other[-1]).max() > APART for other in kept):
            kept.append(path)
    return kept


def branches(arm, pose, rows, slack, seed, tries=60) -> list[np.ndarray]:
    """Up to BEGINNINGS postures (J,) that have the pose, farther than APART from each other, the most comfortable first."""
    found = []
    for q in np.vstack([arm.home, arm.random(tries, seed)]):
        position, rotation = kinematics.reach(arm.chain, arm.lower, arm.upper, pose, q, rows, slack, 60, 1e-6, 0.8)
        if position < POSITION_TOLERANCE / 10 and rotation < ROTATION_TOLERANCE / 10:
            found.append(q[None])
    found = _different(sorted(found, key=lambda q: np.linalg.norm(q - arm.home)), BEGINNINGS)
    return [q[0] for q in found]


def discomfort(arm, path) -> float:
    """How far the joints travel, how fast they must turn at worst, and how near to their limits they come [rad]."""
    steps = np.abs(np.diff(path, axis=0))
    middle, half = (arm.lower + arm.upper) / 2, (arm.upper - arm.lower) / 2
    bounded = np.isfinite(half)
    stretch = np.abs((path - middle)[:, bounded] / half[bounded])
    return float(steps.sum() + len(path) * steps.max(initial=0) + (stretch**8).sum(axis=1).mean())


def path_poses(targets) -> tuple[np.ndarray, int]:
    """Points (T, 3) or poses (T, 4, 4) -> poses (T, 4, 4) and which of their rows count."""
    targets = np.asarray(targets, dtype=float)
    if len(targets) == 0 or not np.isfinite(targets).all():
        raise ValueError("a path must consist of finite numbers")
    if targets.ndim == 3 and targets.shape[1:] == (4, 4):
        return np.ascontiguousarray(targets), POSE
    if targets.ndim != 2 or targets.shape[1] != 3:
        raise ValueError(f"a path is points (T, 3) or poses (T, 4, 4), not {targets.shape}")
    poses = np.tile(np.eye(4), (len(targets), 1, 1))
    poses[:, :3, 3] = targets
    return poses, POSITION


def _pose(base_from_tip) -> np.ndarray:
    pose = np.ascontiguousarray(base_from_tip, dtype=float)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError(f"a pose is a finite (4, 4) matrix, not {pose.shape}")
    if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-4):
        raise ValueError("the rotation of a pose must be orthonormal")
    return pose


def _why(arm, what, q, position, rotation) -> str:
    turned = f" and {np.degrees(rotation):.1f} degrees" if rotation > 0 else ""
    limits = arm.limits_reached(q)
    cause = f"with {' and '.join(limits)}" if limits else "with no joint at a limit: the arm is stretched or folded"
    return f"{arm.name} cannot reach {what}: the best posture stops {1e3 * position:.1f} mm{turned} short, {cause}"
