"""When a task counts as done: conditions that a world's file names, measured in the simulator after the motion.

    success:
      reached_m: 0.05            the hand ends within this of the goal; without a goal, of where the plan ends
      contacts: 0                bodies touched at most, but for those that ``touch`` names
      below: [{body, height}]                       its middle is lower than a height [m]
      inside: [{body, container}]                   its middle is in the room of a crate or cup
      tilted: [{body, degrees}]                     its own upright axis is turned from where it was, at least so far
      opened: [{joint, at_least}]                   the joint stands that far [m or rad] from its lower limit
      closed: [{joint, within}]                     the joint stands that near [m or rad] to its lower limit
      reached: [{body, position, within}]           its middle is that near [m] to a place

Names and numbers only, never code. Each condition is met or not by one measured number and its bound.
"""

from dataclasses import dataclass

import numpy as np

from robot.fields import known, mappings, near, vector
from robot.thing import interior
from robot.thing import pose as file_pose

DEFAULTS = {"reached_m": 0.05, "contacts": 0}
KINDS = {
    "below": ("body", "height"),
    "inside": ("body", "container"),
    "tilted": ("body", "degrees"),
    "opened": ("joint", "at_least"),
    "closed": ("joint", "within"),
    "reached": ("body", "position", "within"),
}


@dataclass(frozen=True)
class Verdict:
    """One condition. name: for metrics, with the unit. value: measured. bound: what it must keep. met: whether it does.
    said: in words."""

    name: str
    value: float
    bound: float
    met: bool
    said: str


def check(data: dict, bodies, joints, where: str) -> None:
    """Raise ValueError where a world's ``success`` or ``touch`` names what there is not, or numbers are none.

    bodies: names of things, the held one among them.
    """
    success = data.get("success") or {}
    known(success, {*DEFAULTS, *KINDS}, f"{where}, success")
    for key, default in DEFAULTS.items():
        if vector({key: success.get(key, default)}, key, 1, f"{where}, success")[0] < 0:
            raise ValueError(f"{where}, success: {key} must not be negative, not {success[key]!r}")
    names = {"body": bodies, "container": bodies, "joint": joints}
    for kind, keys in KINDS.items():
        for condition in mappings(success, kind, f"{where}, success"):
            _check_one(condition, keys, names, f"{where}, success, {kind}")
    containers = {t["name"] for t in data["objects"] if t["shape"] in ("crate", "cup")}
    for condition in success.get("inside", []):
        if condition["container"] not in containers:
            there = near(condition["container"], containers)
            raise ValueError(f"{where}, success, inside: {condition['container']} is no crate or cup{there}")
    for name in data.get("touch", []):
        if name not in bodies:
            raise ValueError(f"{where}, touch: no object is called {name!r}{near(name, bodies)}")


def _check_one(condition, keys, names, where) -> None:
    known(condition, keys, where)
    for key in keys:
        named, there = condition.get(key), names.get(key)
        if there is not None and named not in there:
            kind = "joint" if key == "joint" else "object"
            raise ValueError(f"{where}: no {kind} is called {named!r}{near(named, there)}")
        if key not in names:
            vector(condition, key, 3 if key == "position" else 1, where)


def judged(world) -> list[Verdict]:
    """Every condition of the world's file but the hand's and contacts, by where its things stand now.

    world: World; its ``spec`` says where they stood."""
    success = world.spec.get("success") or {}
    measure = {"below": _below, "inside": _inside, "tilted": _tilted, "opened": _opened, "closed": _closed, "reached": _reached}
    return [measure[kind](world, **condition) for kind in KINDS for condition in success.get(kind, [])]


def hand(tip, place, bound: float) -> Verdict:
    """Whether the hand (3,) ended within ``bound`` [m] of where it was to go (3,)."""
    value = float(np.linalg.norm(np.subtract(tip, place)))
    return Verdict("hand_m", value, bound, value <= bound, f"the hand is {1e3 * value:.1f} mm from where it was to go")


def contacts(touched, bound: int) -> Verdict:
    """Whether no more bodies than that were touched."""
    said = f"{', '.join(touched)} touched" if touched else "nothing touched"
    return Verdict("contacts", len(touched), bound, len(touched) <= bound, said)


def _below(world, body, height) -> Verdict:
    z = float(world.pose(body)[2, 3])
    return Verdict(f"{body}_height_m", z, height, z < height, f"{body} is {z:.3f} m high, to be below {height:.3f}")


def _inside(world, body, container) -> Verdict:
    """The distance to the nearest wall or the rim from inside; negative outside."""
    half, is_round = interior(world.thing(container))
    p = (np.linalg.inv(world.pose(container)) @ world.pose(body))[:3, 3]
    off = [np.hypot(p[0], p[1])] if is_round else np.abs(p[:2]).tolist()
    value = float(min(np.append(half[: len(off)] - off, half[2] - abs(p[2]))))
    where = "inside" if value > 0 else "outside"
    return Verdict(f"{body}_in_{container}_m", value, 0.0, value > 0, f"{body} is {1e3 * abs(value):.0f} mm {where} {container}")


def _tilted(world, body, degrees) -> Verdict:
    now, before = world.pose(body)[:3, 2], file_pose(world.thing(body))[:3, 2]
    value = float(np.degrees(np.arccos(np.clip(now @ before, -1, 1))))
    return Verdict(f"{body}_tilt_deg", value, degrees, value >= degrees, f"{body} is tilted by {value:.0f} degrees, to be {degrees:.0f}")


def _opened(world, joint, at_least) -> Verdict:
    value = world.joint_opening(joint)
    return Verdict(f"{joint}_opening", value, at_least, value >= at_least, f"{joint} is open by {value:.3f}, to be {at_least:.3f}")


def _closed(world, joint, within) -> Verdict:
    value = world.joint_opening(joint)
    return Verdict(f"{joint}_opening", value, within, value <= within, f"{joint} is open by {value:.3f}, to be at most {within:.3f}")


def _reached(world, body, position, within) -> Verdict:
    value = float(np.linalg.norm(world.pose(body)[:3, 3] - position))
    return Verdict(f"{body}_off_m", value, within, value <= within, f"{body} is {1e3 * value:.0f} mm from its place, to be {1e3 * within:.0f}")
