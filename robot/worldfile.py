"""A world's YAML file: read and checked. Plain data, never code.

    name, seed                       seed 0 is the world as published; another one varies it (variation.py)
    objects: [{name, shape: box|cylinder|crate|cup|mesh|parts, position [m], rpy_deg, mass [kg], friction, texture, colour}]     thing.py
    joints: [{name, parent, child, type: prismatic|revolute, axis, lower, upper, at, friction}]   child slides or turns on parent
    held: {name, shape, ..., position, rpy_deg}    a thing in the hand from the start on, in the tip's frame; "gripper_open" releases it
    touch: [names]                   what the motion is meant to touch: no obstacle, no unwanted contact
    tags: [{id, size [m], position, rpy_deg}]      AprilTags 36h11; size is the outer edge of the black square
    workspace: {lower, upper}        the box [m] where motions happen
    view: {target, radius, elevation_deg, azimuth_deg}         what the photographs look at, and from where (photographs.py)
    sketch_views: [{eye, target, fov_deg}]         two to sketch on, one for evaluation
    motion: {via, events, follow, orientation}     what a careful person means: points of the tool's tip [m], the first where the hand starts;
                                     events [[name, share of the motion]]; how far each point follows the goal's object;
                                     letter, at, size [m]: written behind the via points, upright about the place ``at`` (letters.py);
                                     how the hand is turned: free, keep, down, tangent or an axis [x, y, z]
    goal: {object, approach, distance}             the tip ends ``distance`` [m] before the object's centre along ``approach``
    success: {...}                   when the motion counts as done (conditions.py)
    variation: {shift [m], yaw_deg, things, stays} half ranges (variation.py)
    crowd: {count, lower, upper, size, clear}      so many cubes more, in a box, off the motion [m] (variation.py)
    mount: name                      the object that an arm stands on, "pedestal" if left out; a robot with legs does without (mounting.py)
    stand: [x, y, yaw]               where the trunk of a robot with legs stands [m, deg]
    film: {eye, target, fov_deg}     where the performance is filmed from (optional)

Frame: metres, z up, the robot's base. A mass of 0 is fixed. A tag lies with its picture's right along x, its top along y.
A joint's axis and ``at`` (a hinge's place, the child's centre if left out) are in the world's frame; its value is 0 where the
file has the child, ``lower`` and ``upper`` [m or rad] are from there.
"""

from importlib.resources import files
from pathlib import Path

import numpy as np

from robot import conditions, thing
from robot.fields import direction, known, mappings, near, positive, vector
from robot.inverse import tool_of
from robot.letters import letter
from scene.files import read_yaml

JOINTS = ("prismatic", "revolute")
KEYS = {"name", "seed", "objects", "joints", "held", "touch", "tags", "workspace", "view", "sketch_views", "motion", "goal", "success",
        "variation", "crowd", "film", "mount", "stand"}  # fmt: skip
INSIDE = {
    "view": {"target", "radius", "elevation_deg", "azimuth_deg"},
    "workspace": {"lower", "upper"},
    "motion": {"via", "events", "follow", "orientation", "letter", "at", "size", "right"},
    "goal": {"object", "approach", "distance"},
    "variation": {"shift", "yaw_deg", "things", "stays"},
    "crowd": {"count", "lower", "upper", "size", "clear"},
    "film": {"eye", "target", "fov_deg"},
}
JOINT_KEYS = {"name", "parent", "child", "type", "axis", "lower", "upper", "at", "friction"}
EVENTS = ("contact", "gripper_open", "gripper_close")
TAGS = 587  # in the family 36h11


def names() -> list[str]:
    """The worlds that come with the project."""
    return sorted(path.name.removesuffix(".yaml") for path in (files("conf") / "world").iterdir() if path.name.endswith(".yaml"))


def read(name_or_path) -> dict:
    """The checked, not yet varied, data of a world. Raises FileNotFoundError or ValueError."""
    path = Path(name_or_path)
    source = path if path.suffix else files("conf") / "world" / f"{name_or_path}.yaml"
    data = read_yaml(source, f"unknown world {str(name_or_path)!r}; there are {', '.join(names())}, or give the path of a YAML file")
    check(data)
    return data


def check(data: dict) -> None:
    """Raise ValueError at the first thing that is wrong, naming the object and the field."""
    if not isinstance(data, dict) or not isinstance(data.get("name"), str) or not isinstance(data.get("objects"), list):
        raise ValueError("a world is a mapping with at least a name and a list of objects")
    where = f"world {data['name']}"
    known(map(str, data), KEYS, where)
    bodies = _check_objects(data, where)
    joints = {_check_joint(joint, data["objects"], f"{where}, joint {joint.get('name')}") for joint in mappings(data, "joints", where)}
    if len(joints) < len(data.get("joints", [])):
        raise ValueError(f"{where}: two joints have one name")
    _check_tags(mappings(data, "tags", where), where)
    for key in ("view", "workspace", "motion", "goal", "success", "film", "variation", "crowd"):
        if data.get(key) is not None and not isinstance(data[key], dict):
            raise ValueError(f"{where}: {key} must be a mapping, not {data[key]!r}")
        known(map(str, data.get(key) or {}), INSIDE.get(key, data.get(key) or {}), f"{where}, {key}")
    _check_views(data, where)
    _check_motion(data.get("motion") or {}, where)
    if data.get("goal"):
        _check_goal(data["goal"], {one["name"] for one in data["objects"]}, where)
    conditions.check(data, bodies, joints, where)
    _check_variation(data, where)
    if data.get("crowd"):
        _check_crowd(data["crowd"], f"{where}, crowd")


def _check_objects(data: dict, where: str) -> set[str]:
    """The names of all things, the held one among them."""
    seen = set()
    held = [data["held"]] if data.get("held") else []
    for number, one in enumerate([*data["objects"], *held]):
        thing.check(one, f"{where}, object {one.get('name', number) if isinstance(one, dict) else number}")
        if one["name"] in seen:
            raise ValueError(f"{where}: two objects are called {one['name']}")
        seen.add(one["name"])
    if held and not held[0].get("mass"):
        raise ValueError(f"{where}, held {held[0]['name']}: what is held needs a mass")
    if data.get("mount") is not None and data["mount"] not in seen:
        raise ValueError(f"{where}: mount {data['mount']!r} is not an object{near(data['mount'], seen)}")
    if data.get("stand") is not None:
        vector(data, "stand", 3, where)
    if not isinstance(data.get("touch", []), list):
        raise ValueError(f"{where}: touch must be a list of names, not {data['touch']!r}")
    return seen


def _check_tags(tags: list[dict], where: str) -> None:
    for tag in tags:
        number = tag.get("id")
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < TAGS:
            raise ValueError(f"{where}: a tag's id must be a number from 0 to {TAGS - 1}, not {number!r}")
        positive(tag, "size", 1, f"{where}, tag {number}")
        vector(tag, "position", 3, f"{where}, tag {number}")
        vector({"rpy_deg": tag.get("rpy_deg", [0, 0, 0])}, "rpy_deg", 3, f"{where}, tag {number}")
    if len({tag["id"] for tag in tags}) < len(tags) or len({float(tag["size"]) for tag in tags}) > 1:
        raise ValueError(f"{where}: tags must have different ids and one size")


def _check_joint(joint: dict, objects: list[dict], where: str) -> str:
    """The joint's name."""
    known(map(str, joint), JOINT_KEYS, where)
    if not isinstance(joint.get("name"), str):
        raise ValueError(f"{where}: name must be text, not {joint.get('name')!r}")
    if joint.get("type") not in JOINTS:
        raise ValueError(f"{where}: type {joint.get('type')!r} is none of {', '.join(JOINTS)}")
    by_name = {one["name"]: one for one in objects}
    for end in ("parent", "child"):
        if joint.get(end) not in by_name:
            raise ValueError(f"{where}: its {end} {joint.get(end)!r} is not an object{near(joint.get(end), by_name)}")
    if by_name[joint["parent"]].get("mass") or not by_name[joint["child"]].get("mass"):
        raise ValueError(f"{where}: its parent must be fixed (mass 0) and its child must have a mass")
    direction(joint, "axis", where)
    lower, upper = (vector(joint, side, 1, where)[0] for side in ("lower", "upper"))
    if not lower <= 0 <= upper or lower == upper:
        raise ValueError(f"{where}: limits must lie around 0, where the file has the child, not {lower} to {upper}")
    if "at" in joint:
        vector(joint, "at", 3, where)
    if vector({"friction": joint.get("friction", 0)}, "friction", 1, where)[0] < 0:
        raise ValueError(f"{where}: friction must not be negative, not {joint['friction']!r}")
    return joint["name"]


def _check_views(data: dict, where: str) -> None:
    for i, view in enumerate(mappings(data, "sketch_views", where)):
        _check_view(view, f"{where}, sketch view {i}")
    if data.get("film"):
        _check_view(data["film"], f"{where}, film")
    view = data.get("view")
    if view:
        vector(view, "target", 3, f"{where}, view")
        for key in ("radius", "elevation_deg", "azimuth_deg"):
            vector({key: view.get(key, [0, 0])}, key, 2, f"{where}, view")
    for side in data.get("workspace") or {}:
        vector(data["workspace"], side, 3, f"{where}, workspace")


def _check_motion(motion: dict, where: str) -> None:
    via, events = motion.get("via", []), motion.get("events", [])
    if motion and (not isinstance(via, list) or len(via) < 2):
        raise ValueError(f"{where}, motion: via must be at least two points, not {via!r}")
    for i, point in enumerate(via):
        vector({"via": point}, "via", 3, f"{where}, via point {i}")
    tool_of(motion.get("orientation"), 0.0, np.eye(3))
    if motion.get("letter") is not None:
        letter(motion["letter"])
        vector(motion, "at", 3, f"{where}, motion")
        positive(motion, "size", 1, f"{where}, motion")
    if "follow" in motion:
        vector(motion, "follow", len(via), f"{where}, motion")
    if not isinstance(events, list) or not all(isinstance(event, list) and len(event) == 2 for event in events):
        raise ValueError(f"{where}, motion: events must be a list of [name, share of the motion], not {events!r}")
    for name, share in events:
        if name not in EVENTS:
            raise ValueError(f"{where}, motion: unknown event {name!r}{near(name, EVENTS)}")
        if not 0 <= vector({"share": share}, "share", 1, f"{where}, event {name}")[0] <= 1:
            raise ValueError(f"{where}, motion: event {name} must lie between 0 and 1, not {share!r}")


def _check_goal(goal: dict, objects: set[str], where: str) -> None:
    if goal.get("object") not in objects:
        raise ValueError(f"{where}: the goal's object {goal.get('object')!r} is none of {', '.join(sorted(objects))}")
    direction(goal, "approach", f"{where}, goal")
    vector(goal, "distance", 1, f"{where}, goal")


def _check_view(view: dict, where: str) -> None:
    if vector(view, "eye", 3, where) == vector(view, "target", 3, where):
        raise ValueError(f"{where}: eye and target are the same point")
    if not 0 < vector(view, "fov_deg", 1, where)[0] < 180:
        raise ValueError(f"{where}: fov_deg must lie between 0 and 180, not {view['fov_deg']!r}")


def _check_crowd(crowd: dict, where: str) -> None:
    count = crowd.get("count")
    if not isinstance(count, int) or isinstance(count, bool) or count < 0:
        raise ValueError(f"{where}: count must be a whole number from 0 on, not {count!r}")
    lower, upper = (vector(crowd, side, 3, where) for side in ("lower", "upper"))
    if not all(a <= b for a, b in zip(lower, upper, strict=True)):
        raise ValueError(f"{where}: lower {lower} lies above upper {upper}")
    positive(crowd, "size", 1, where)
    if vector(crowd, "clear", 1, where)[0] < 0:
        raise ValueError(f"{where}: clear must not be negative, not {crowd['clear']!r}")


def _check_variation(data: dict, where: str) -> None:
    seed, variation = data.get("seed", 0), data.get("variation") or {}
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ValueError(f"{where}: seed must be a whole number, 0 for the world as published, not {seed!r}")
    vector({"shift": variation.get("shift", [0, 0, 0])}, "shift", 3, f"{where}, variation")
    vector({"yaw_deg": variation.get("yaw_deg", 0)}, "yaw_deg", 1, f"{where}, variation")
    objects, moved = {one["name"] for one in data["objects"]}, variation.get("things") or {}
    if not isinstance(moved, dict) or not isinstance(variation.get("stays", []), list):
        raise ValueError(f"{where}, variation: things must be a mapping of names to [m], stays a list of names")
    known([*moved, *variation.get("stays", [])], objects, f"{where}, variation")
    for name in moved:
        vector(moved, name, 3, f"{where}, variation, things")
    if seed and variation and not data.get("view"):
        raise ValueError(f"{where}: a world that varies needs a view with the target that it turns about")
