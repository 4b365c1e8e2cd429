"""Where the robot should stand for a motion: base pose search.

A robot with legs walks to a place from which it can perform the motion; of an arm it can be said where its base would
have to stand.

Notation
    T     world_from_moved (4, 4): a displacement of the robot, and of what it is mounted on, over the floor: x, y, yaw.
          What stands in the world the moved robot has at T^-1 x, so that its own joints and frames stay as they are

    1. Places on a grid around the path are screened: how much of the path the hand can follow with the base held still,
       how far from home and how near to limits the joints then are, and how far away the place is.
    2. Of the best, the robot must stand clear, and its mount too; what is nearer than comfortable costs more. Feet that stand
       on something here must do so there.
    3. The first from which the planner's own search finds a feasible attempt at the mean (attempt.py) is taken.
"""

from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from robot import kinematics
from robot.approach import BESIDE, beginnings
from robot.attempt import Search
from robot.collision import WORLD
from robot.inverse import LARGEST_STEP, POSITION_TOLERANCE, ROTATION_TOLERANCE, Tool

GRID, AROUND = 0.1, 1.0  # m, between places, and how far from the middle of the path they lie
TURNS = np.radians([-45, 0, 45])  # of a robot with legs, from facing the middle of the path
COARSE, STARTS = 25, 6  # waypoints of the screening, and postures that it begins from
CLOSER, TRIED = 60, 6  # places where it stands clear whose path is measured, and those that are planned from
UNDER = 0.02  # m, from a foot's sole to what it stands on
AWAY, CLOSE = 1.5, 1.0  # cost of a metre (or radian) away from here, and of no clearance where it should be comfortable [rad]


@dataclass(frozen=True, eq=False)
class Place:
    """A place to stand. shift (2,) [m] and yaw [rad] from where the robot stands, in its own directions. world_from_moved
    (4, 4): T. start (J,): home there. share: of the path that the hand reaches with the base still. cost [rad]. path
    (K, J): the postures on it, as of the robot where it stands now."""

    shift: np.ndarray
    yaw: float
    world_from_moved: np.ndarray
    start: np.ndarray
    share: float
    cost: float
    path: np.ndarray

    def __str__(self):
        ways = ((self.shift[0], "forward", "back"), (self.shift[1], "left", "to the right"))
        said = [f"{abs(d):.2f} m further {more if d > 0 else less}" for d, more, less in ways if abs(d) > 5e-3]
        turned = f"turned by {np.degrees(self.yaw):.0f} degrees"
        return " and ".join(said + [turned] * (abs(self.yaw) > 1e-3))


def search(search: Search, skill, approach: float | None, mount: str | None = None) -> Place | None:
    """The place from which the skill's mean is feasible, the most comfortable that is found; None where none is.

    search: as from where the robot stands, ``start`` being where its arm starts. approach [m]: as in planner.plan. mount:
    the body that the robot stands on and takes with it.
    """
    points = skill.distribution.mean_at(np.linspace(0, 1, COARSE))
    screened = (_screened(search, place, points) for place in _places(search, points))
    ranked = sorted((place for place in screened if place.share > 0), key=lambda place: (-place.share, place.cost))
    gaps = search.model.gaps(mount) if mount else {}
    standing = islice((place for place in ranked if _stands_clear(search, place, mount, gaps)), CLOSER)
    refused = []
    for place in sorted((_cleared(search, place, mount) for place in standing), key=lambda place: (-place.share, place.cost)):
        if len(refused) == TRIED:
            break
        if all(_apart(place, other) for other in refused):
            if _stands_on(search, place) and _feasible(search, place, skill, approach, mount):
                return place
            refused.append(place)
    return None


def _places(search, points):
    """Places on a grid about the middle of the path (N, 3), but for here."""
    arm, middle = search.arm, points.mean(axis=0)[:2]
    at, facing = (search.start[:2], search.start[2]) if arm.legs else (np.zeros(2), 0.0)
    steps = GRID * np.arange(-40, 41)
    shifts = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    turn = _displaced(np.zeros(2), facing)[:2, :2]
    for shift in shifts[np.linalg.norm(at + shifts @ turn.T - middle, axis=1) < AROUND]:
        ahead = middle - at - turn @ shift
        towards = np.arctan2(ahead[1], ahead[0]) - facing
        for yaw in {0.0, *(np.round((towards + TURNS + np.pi) % (2 * np.pi) - np.pi, 2) if arm.legs else ())}:
            if shift.any() or yaw:
                yield _place(search, shift, float(yaw))


def _place(search, shift, yaw) -> Place:
    start, arm = search.start, search.arm
    at, facing = (start[:2], start[2]) if arm.legs else (np.zeros(2), 0.0)
    to = at + _displaced(np.zeros(2), facing)[:2, :2] @ shift
    T = _displaced(to, yaw) @ _displaced(-at, 0.0)
    there = np.array([*to, facing + yaw, *start[3:]]) if arm.legs else start
    return Place(shift, yaw, T, there, 0.0, np.inf, start[None])


def _displaced(to, yaw) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2], T[:2, 3] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]], to
    return T


def _seen(place, points) -> np.ndarray:
    """Points (N, 3) of the world as the robot that stands there has them."""
    return (points - place.world_from_moved[:3, 3]) @ place.world_from_moved[:3, :3]


def _turned(tool: Tool, place) -> Tool:
    return replace(tool, axis=tool.axis @ place.world_from_moved[:3, :3]) if tool.kind == "pointed" else tool


def _screened(search, place, points) -> Place:
    """The place with how much of the path the hand can follow from home with the base still, and what that costs."""
    arm = search.arm
    if not arm.within_limits(place.start)[0]:
        return place
    poses, rows = _turned(search.tool, place).poses(_seen(place, points))
    still = arm.still(search.start)
    limits, slack = (arm.chain, still.lower, still.upper), search.tool.tolerance
    starts = np.vstack([search.start, still.random(STARTS, 0)])
    q, position, _ = kinematics.solve(*limits, poses[0], starts, rows, slack, 40, POSITION_TOLERANCE, ROTATION_TOLERANCE)
    if position > POSITION_TOLERANCE:
        return place
    rests = np.tile(arm.home if arm.legs is None else search.start, (len(poses), 1))
    path, position, rotation = kinematics.track(*limits, poses, rests, q, 0.5, rows, slack, 1e-5)
    jumps = np.abs(np.diff(path, axis=0, prepend=path[:1])).max(axis=1) > LARGEST_STEP * 100 / COARSE
    bad = np.flatnonzero((position > POSITION_TOLERANCE) | (rotation > ROTATION_TOLERANCE) | jumps)
    reached = int(bad[0]) if len(bad) else len(path)
    return replace(place, share=reached / len(path), cost=_cost(arm, place, path[: max(reached, 1)], rests[0]), path=path[: max(reached, 1)])


def _cost(arm, place, path, rest) -> float:
    """Joints far from rest [rad] and near to limits, and the way there."""
    middle, half = (arm.lower + arm.upper) / 2, (arm.upper - arm.lower) / 2
    bounded = np.isfinite(half)
    stretch = np.abs((path - middle)[:, bounded] / half[bounded])
    away = np.linalg.norm(place.shift) + abs(place.yaw) / 2
    return float(np.abs(path - rest).mean() + (stretch**8).sum(axis=1).mean() + AWAY * away)


def _stands_clear(search, place, mount, gaps) -> bool:
    """Whether nothing is too near to the robot at home there, or to its mount that was not near to it before."""
    model = search.model.standing(place.world_from_moved, mount)
    if model.measure(search.start)[0][0, WORLD] < search.margin + BESIDE:
        return False
    there = model.gaps(mount) if mount else {}
    return all(there[name] >= search.margin for name, gap in gaps.items() if gap >= search.margin)


def _stands_on(search, place) -> bool:
    """Whether there is something below each foot that has something below it where the robot stands now."""
    if search.arm.legs is None:
        return True
    legs, trunk = search.arm.legs, search.arm.link_names.index(search.arm.legs.trunk)
    soles = legs.stance(search.arm.link_poses(search.start)[0, trunk]) - [0, 0, legs.radius]
    there = search.model.standing(place.world_from_moved)
    return all(there.beside(sole, UNDER) for sole in soles if search.model.beside(sole, UNDER))


def _cleared(search, place, mount) -> Place:
    """The place with how much of the path is reached and clear; what is nearer than comfortable costs."""
    model = search.model.standing(place.world_from_moved, mount)
    clearance = model.measure(place.path)[0].min(axis=1)
    short = np.flatnonzero(clearance < search.margin)
    near = np.clip(1 - clearance.min() / search.comfortable, 0, 1) if search.comfortable > 0 else 0.0
    return replace(place, share=(int(short[0]) if len(short) else len(clearance)) / COARSE, cost=place.cost + CLOSE * near)


def _apart(a, b) -> bool:
    return np.linalg.norm(a.shift - b.shift) > 2.5 * GRID or abs(a.yaw - b.yaw) > 0.5


def _feasible(search, place, skill, approach, mount) -> bool:
    """Whether the planner's own search follows the mean from there, with all that it tries."""
    arm, t = search.arm, np.linspace(0, 1, 100)
    model = search.model.standing(place.world_from_moved, mount)
    moved = replace(search, model=model, tool=_turned(search.tool, place))
    hand = (place.world_from_moved @ arm.fk(search.start))[:3, 3]
    begin = skill.distribution.mean_at([0.0])[0]
    if approach is None or np.linalg.norm(hand - begin) <= approach:
        points = skill.starting_at(hand)[0].distribution.mean_at(t)
    else:
        points, found = skill.distribution.mean_at(t), beginnings(model, search.start, _seen(place, begin), search.margin + BESIDE, 0)
        if not found:
            return False
        moved = replace(moved, start=found[0])
    taught = skill.orientation if isinstance(skill.orientation, np.ndarray) else None
    if taught is not None:
        turned = Rotation.from_matrix(place.world_from_moved[:3, :3]).inv() * Rotation.from_quat(taught[:, 1:])
        taught = np.column_stack([taught[:, 0], turned.as_quat()])
    return not moved.all(_seen(place, points)[None], taught)[0].refusal
