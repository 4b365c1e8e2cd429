"""Which way to hold the arm: end postures of a path, and the joint path that leads from the start to one of them.

The taught motion fixes where the tip is, not how it is turned. A *profile* fills that freedom: an end posture, and a
schedule 0 -> 1 by which the arm changes from its start posture to it. In between, the posture is the one nearest to the
straight line in joint space between both among those whose tip is on the path, so that hand and elbow turn smoothly.

Where the hand's orientation is asked for (Tool), it turns there from how it is within the first of TURNINGS of the path
that the arm can follow, and the profile fills what is left: the roll about the axis, or nothing.

End postures have the tip's z axis (the approach axis) tilted from straight down towards horizontal, along the heading
at the path's end and away from the base, at all rolls about it; one more keeps the present orientation, one is free.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from robot.arm import Arm, NoSolution
from robot.collision import WORLD
from robot.inverse import LARGEST_STEP, POSITION_TOLERANCE, ROTATION_TOLERANCE, Tool, follow
from robot.kinematics import POINTED, POSE

TILTS = np.radians([0, 30, 60, 90])
ROLLS = np.radians([0, 45, 90, 135, 180, 225, 270, 315])
TURNINGS = (0.35, 0.7)  # shares of the path within which the hand comes to be turned as it is asked to; the later if it must
SCHEDULES = {"evenly": lambda t: t, "early": lambda t: np.clip(t / 0.6, 0, 1) ** 2 * (3 - 2 * np.clip(t / 0.6, 0, 1))}


@dataclass(frozen=True, eq=False)
class Profile:
    """end (J,): the posture at the path's end. schedule: a name of SCHEDULES. free: the end's orientation does not
    matter.

    turned: orientations (T, 3, 3) of the tip along the path where they are taught or asked for, of which ``rows`` count
    (kinematics.py) but for ``slack`` [rad]. turning: share of the path within which it turns there.
    """

    end: np.ndarray
    schedule: str = "evenly"
    free: bool = False
    turned: np.ndarray | None = None
    rows: int = POSE
    slack: float = 0.0
    turning: float = 0.0


def heading(points) -> np.ndarray:
    """Horizontal unit direction (3,) of the last fifth of a path (T, 3); away from the base where it has none."""
    travel = points[-1] - points[int(0.8 * (len(points) - 1))]
    for direction in (travel, points[-1], np.array([1.0, 0, 0])):
        flat = direction * [1, 1, 0]
        if np.linalg.norm(flat) > 0.02:
            break
    return flat / np.linalg.norm(flat)


def orientations(points, present) -> np.ndarray:
    """Orientations (O, 3, 3) of the tip at the end of a path (T, 3) that starts at the orientation ``present`` (3,
    3)."""
    outwards = heading(np.vstack([np.zeros(3), points[-1]]))
    family = [present]
    for forward, tilt, roll in product((heading(points), outwards), TILTS, ROLLS):
        z = np.cos(tilt) * np.array([0, 0, -1.0]) + np.sin(tilt) * forward
        y = np.cross([0, 0, 1.0], forward)
        x = np.cross(y, z)
        c, s = np.cos(roll), np.sin(roll)
        family.append(np.column_stack([c * x + s * y, c * y - s * x, z]))
    return np.array(family)


def taught_profile(arm: Arm, orientation, start, count) -> Profile:
    """The profile of a taught orientation, rows (t, quat_xyzw) (K, 5), over ``count`` waypoints.

    The path begins as the hand is turned now; what was taught for t = 0 gives way to that.
    """
    later = orientation[orientation[:, 0] > 1e-3]
    later = later[np.argsort(later[:, 0], kind="stable")]
    keys = Rotation.from_quat(np.vstack([Rotation.from_matrix(arm.fk(start)[:3, :3]).as_quat(), later[:, 1:]]))
    t = np.clip(np.linspace(0, 1, count), 0, later[-1, 0] if len(later) else 0)
    turned = Slerp(np.append(0, later[:, 0]), keys)(t) if len(later) else Rotation.concatenate([keys] * count)
    return Profile(arm.home, turned=turned.as_matrix())


def tool_profiles(arm: Arm, tool: Tool, points, start) -> list[Profile]:
    """Profiles along a path (T, 3) on which the hand is turned as ``tool`` says; none where it cannot be at the end."""
    poses, rows = tool.poses(points)
    rolls = ROLLS if rows == POINTED else ROLLS[:1]
    about = Rotation.from_euler("z", rolls[:, None]).as_matrix()
    found = [_reachable(arm, points[-1], poses[-1, :3, :3] @ R, start) for R in about]
    ends = []
    for q in sorted((q for q in found if q is not None), key=lambda q: np.abs(q - start).max()):
        if all(np.abs(q - other).max() > 0.1 for other in ends):
            ends.append(q)
    eased = {turning: _eased(arm.fk(start)[:3, :3], poses[:, :3, :3], rows, turning) for turning in TURNINGS}
    return [
        Profile(q, name, turned=eased[turning], rows=rows, slack=tool.tolerance, turning=turning)
        for turning, q, name in product(TURNINGS, ends, SCHEDULES)
    ]


def _eased(present, turned, rows, turning) -> np.ndarray:
    """Orientations (T, 3, 3) that begin at ``present`` (3, 3) and are those of ``turned`` (T, 3, 3) after ``turning``."""
    share = np.clip(np.linspace(0, 1, len(turned)) / turning, 0, 1)
    share = share**2 * (3 - 2 * share)
    if rows == POINTED:  # the shortest way there leaves the roll about z as it is
        vectors = np.array([_between(present[:, 2], R[:, 2]) for R in turned])
    else:
        vectors = Rotation.from_matrix(turned @ present.T).as_rotvec()
    return Rotation.from_rotvec(share[:, None] * vectors).as_matrix() @ present


def _between(a, b) -> np.ndarray:
    """The shortest rotation vector (3,) [rad] from unit vector a to b."""
    across = np.cross(a, b)
    if np.linalg.norm(across) < 1e-9:
        across = np.cross(a, np.eye(3)[np.abs(a).argmin()]) * (a @ b < 0)
    length = max(np.linalg.norm(across), 1e-12)
    return across / length * np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


def end_profiles(arm: Arm, model, points, start, count, margin) -> list[Profile]:
    """Up to ``count`` end postures of a path (T, 3), those farthest from the world first, and the free one last.

    model: CollisionModel. Only postures at least ``margin`` [m] clear are kept.
    """
    present = arm.fk(start)[:3, :3]
    postures, free = [], _reachable(arm, points[-1], None, start)
    for R in orientations(points, present):
        q = _reachable(arm, points[-1], R, start)
        if q is not None and all(np.abs(q - other).max() > 0.1 for other in postures):
            postures.append(q)
    ranked = []
    if postures:
        clearance, _ = model.measure(np.array(postures))
        clear = clearance.min(axis=1) >= margin
        ranked = [postures[k] for k in np.argsort(-clearance[:, WORLD], kind="stable") if clear[k]][:count]
    profiles = [Profile(q, schedule) for q in ranked for schedule in SCHEDULES]
    return profiles + ([] if free is None else [Profile(free, "evenly", free=True)])


def _reachable(arm, point, R, start):
    """A posture there, or None: most orientations of the family are out of reach, which is no failure."""
    pose = np.eye(4)
    pose[:3, 3] = point
    if R is not None:
        pose[:3, :3] = R
    try:
        return arm.ik(pose, start=start, position_only=R is None, restarts=2)
    except NoSolution:
        return None


def path_to(arm: Arm, points, start, profile: Profile) -> np.ndarray:
    """The joint path (T, J) along points (T, 3) from ``start`` to the profile's end. Raises NoSolution."""
    if profile.turned is not None:
        poses = np.tile(np.eye(4), (len(points), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = profile.turned, points
        tolerances = POSITION_TOLERANCE, ROTATION_TOLERANCE, LARGEST_STEP, profile.slack
        return _from(start, follow(arm, poses, profile.rows, start, _drawn(profile, start, len(points)), 0.5, *tolerances))
    end = profile.end if profile.free else _moved_end(arm, points, profile)
    rest = _drawn(replace(profile, end=end), start, len(points))
    return _from(start, arm.follow(points, start=start, rest=rest, gain=0.8))


def _drawn(profile, start, count) -> np.ndarray:
    """(T, J) from the start to the profile's end by its schedule."""
    return start + (profile.end - start) * SCHEDULES[profile.schedule](np.linspace(0, 1, count))[:, None]


def _from(start, path) -> np.ndarray:
    """The path, begun exactly where the arm is if that is where it begins: iterations leave some micrometres."""
    return np.vstack([start, path[1:]]) if np.abs(path[0] - start).max() < 1e-3 else path


def _moved_end(arm, points, profile) -> np.ndarray:
    """The profile's end with its orientation, moved to where this path ends: samples end a little apart."""
    pose = arm.fk(profile.end)
    pose[:3, 3] = points[-1]
    try:
        return arm.follow(pose[None], start=profile.end, rest=profile.end, largest_step=1.0)[0]
    except NoSolution:
        return profile.end  # out of reach turned like this: as near to it as the path allows
