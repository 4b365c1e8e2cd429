"""A world under its seed: some things are moved first, then all of it is shifted and turned about ``view.target``.

    variation: {shift [m], yaw_deg, things: {name: [m]}, stays: [names]}       half ranges of uniform draws

Things move along the world's axes, redrawn until they are free of contact (with what they stand clear of as published:
the published cans sink into their boards). The goal's thing takes the intended motion
with it: the via points by their share in ``motion.follow`` (the first, where the hand starts, by none; the others, where
nothing is said, by all). Seed 0 is the world as published; what ``stays`` stands with the robot.

    crowd: {count, lower, upper [m], size [m], clear [m]}     fixed cubes anywhere in a box, ``clear`` of the straight lines between via points
"""

import copy

import numpy as np

from robot.letters import on_board
from robot.standing import free
from robot.thing import placed

REDRAWS = 200


def varied(data: dict) -> dict:
    """The world as it is built: a copy, moved and turned under its seed. Raises ValueError where nothing fits."""
    data = copy.deepcopy(data)
    if (data.get("motion") or {}).get("letter"):
        data["motion"]["via"] += on_board(data["motion"]["letter"], data["motion"]["at"], data["motion"]["size"]).tolist()
    data["objects"] += _crowd(data)
    variation = data.get("variation") or {}
    if not data.get("seed") or not variation:
        return data
    rng = np.random.default_rng(data["seed"])
    shift = rng.uniform(-1, 1, 3) * variation.get("shift", [0, 0, 0])
    yaw = rng.uniform(-1, 1) * variation.get("yaw_deg", 0)
    _move_things(data, variation.get("things") or {}, rng)
    return _turned(data, shift, yaw, variation.get("stays", []))


def _crowd(data: dict) -> list[dict]:
    """The cubes of ``crowd``: the first of more are those of fewer."""
    crowd = data.get("crowd") or {"count": 0}
    rng = np.random.default_rng([data.get("seed", 0), 1])
    via = np.array((data.get("motion") or {}).get("via", []), dtype=float).reshape(-1, 3)
    cubes: list[dict] = []
    for _ in range(REDRAWS * crowd["count"]):
        if len(cubes) == crowd["count"]:
            break
        centre, yaw = rng.uniform(crowd["lower"], crowd["upper"]), rng.uniform(0, 90)
        if _distance(centre, via) > crowd["clear"] + crowd["size"] * np.sqrt(3) / 2:
            cubes.append({"name": f"crowd{len(cubes)}", "shape": "box", "size": [crowd["size"]] * 3, "position": centre.tolist(), "rpy_deg": [0, 0, float(yaw)]})
    if len(cubes) < crowd["count"]:
        raise ValueError(f"world {data['name']}: {crowd['count']} cubes found no place clear of the motion; make crowd's box larger, or clear smaller")
    return cubes


def _distance(point, via: np.ndarray) -> float:
    """From a point (3,) to the straight lines between via points (n, 3) [m]; inf where there are none."""
    if len(via) < 2:
        return np.inf
    start, along = via[:-1], np.diff(via, axis=0)
    share = np.clip(((point - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12), 0, 1)
    return float(np.linalg.norm(start + share[:, None] * along - point, axis=1).min())


def _move_things(data: dict, ranges: dict, rng) -> None:
    things = {thing["name"]: thing for thing in data["objects"]}
    before = {name: np.array(things[name]["position"], dtype=float) for name in ranges}
    apart = {name: [o for o in data["objects"] if o["name"] != name and free(things[name], [o])] for name in ranges}
    for _ in range(REDRAWS):
        for name, half in ranges.items():
            things[name]["position"] = (before[name] + rng.uniform(-1, 1, 3) * half).tolist()
        if all(free(things[name], apart[name]) for name in ranges):
            break
    else:
        raise ValueError(f"world {data['name']}: in {REDRAWS} draws {', '.join(ranges)} never stood free; make variation.things smaller")
    goal = (data.get("goal") or {}).get("object")
    if goal in ranges and data.get("motion"):
        _follow(data["motion"], np.subtract(things[goal]["position"], before[goal]))


def _follow(motion: dict, moved) -> None:
    shares = motion.get("follow") or [0.0] + [1.0] * (len(motion["via"]) - 1)
    motion["via"] = [(np.array(point) + share * moved).tolist() for point, share in zip(motion["via"], shares, strict=True)]


def _turned(data: dict, shift, yaw: float, stays) -> dict:
    """Everything but what stays, and where the hand starts, turned by ``yaw`` [deg] and shifted [m]."""
    centre = np.array(data["view"]["target"], dtype=float)
    turn = placed([0, 0, 0], [0, 0, yaw])[:3, :3]

    def moved(point):
        return (turn @ (np.array(point, dtype=float) - centre) + centre + shift).tolist()

    for thing in (*(t for t in data["objects"] if t["name"] not in stays), *data.get("tags", [])):
        thing["position"] = moved(thing["position"])
        roll, pitch, old = thing.get("rpy_deg", [0, 0, 0])
        thing["rpy_deg"] = [roll, pitch, old + float(yaw)]
    for joint in data.get("joints", []):
        joint["axis"] = (turn @ joint["axis"]).tolist()
        if "at" in joint:
            joint["at"] = moved(joint["at"])
    for view in (*data.get("sketch_views", []), *([data["film"]] if data.get("film") else [])):
        view["eye"], view["target"] = moved(view["eye"]), moved(view["target"])
    if data.get("motion"):
        via = data["motion"]["via"]
        data["motion"]["via"] = [via[0], *map(moved, via[1:])]
        if data["motion"].get("letter"):
            data["motion"]["right"] = (turn @ [0.0, -1.0, 0.0]).tolist()
        axis = data["motion"].get("orientation")
        if isinstance(axis, list):
            data["motion"]["orientation"] = (turn @ axis).tolist()
    if data.get("goal"):
        data["goal"]["approach"] = (turn @ data["goal"]["approach"]).tolist()
    for condition in (data.get("success") or {}).get("reached", []):
        condition["position"] = moved(condition["position"])
    for condition in (data.get("success") or {}).get("below", []):
        condition["height"] += float(shift[2])
    if "azimuth_deg" in data["view"]:
        data["view"]["azimuth_deg"] = [angle + float(yaw) for angle in data["view"]["azimuth_deg"]]
    data["view"]["target"] = moved(centre)
    return data


def pre_grasp(data: dict) -> np.ndarray:
    """Where the tip ends (3,) [m]: before the goal's object along the approach."""
    goal = data["goal"]
    (thing,) = (thing for thing in data["objects"] if thing["name"] == goal["object"])
    approach = np.array(goal["approach"], dtype=float)
    return np.array(thing["position"]) - goal["distance"] * approach / np.linalg.norm(approach)
