"""A world's YAML file: read, checked, and varied under its seed. Plain data, never code.

    name, seed                       seed 0 is the world as published; another one shifts and turns it by ``variation``
    objects: [{name, shape: box|cylinder|mesh, size | height, radius | file, position [m], rpy_deg, mass [kg], texture, colour}]
    joints: [{name, parent, child, type: prismatic|revolute, axis, lower, upper}]      child slides or turns on parent
    tags: [{id, size [m], position, rpy_deg}]      AprilTags 36h11; size is the outer edge of the black square
    workspace: {lower, upper}        the box [m] where motions happen
    view: {target}                   what the photographs look at
    sketch_views: [{eye, target, fov_deg}]         two to sketch on, one for evaluation
    motion: {via}                    what a careful person means: points of the tool's tip [m], the first where the hand starts
    goal: {object, approach, distance}             the tip ends ``distance`` [m] before the object's centre along ``approach``
    success: {reached_m, contacts}   when the motion counts as done

Frame: metres, z up, the robot's base. A mass of 0 is fixed. A tag lies with its picture's right along x, its top along y.
"""

import copy
import math
from importlib.resources import files
from pathlib import Path

import numpy as np
import yaml

SHAPES = {"box": {"size": 3}, "cylinder": {"height": 1, "radius": 1}, "mesh": {"file": 0}}
TEXTURES = ("wood", "cardboard", "label", "concrete", "metal")
JOINTS = ("prismatic", "revolute")


def names() -> list[str]:
    """The worlds that come with the project."""
    return sorted(path.name.removesuffix(".yaml") for path in (files("conf") / "world").iterdir() if path.name.endswith(".yaml"))


def read(name_or_path) -> dict:
    """The checked, not yet varied, data of a world. Raises FileNotFoundError or ValueError."""
    path = Path(name_or_path)
    source = path if path.suffix else files("conf") / "world" / f"{name_or_path}.yaml"
    if not source.is_file():
        raise FileNotFoundError(f"unknown world {str(name_or_path)!r}; there are {', '.join(names())}, or give the path of a YAML file")
    try:
        data = yaml.safe_load(source.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{source} is not YAML: {error}") from None
    check(data)
    return data


def check(data: dict) -> None:
    """Raise ValueError at the first thing that is wrong, naming the object and the field."""
    if not isinstance(data, dict) or not isinstance(data.get("name"), str) or not isinstance(data.get("objects"), list):
        raise ValueError("a world is a mapping with at least a name and a list of objects")
    where = f"world {data['name']}"
    seen = set()
    for number, thing in enumerate(data["objects"]):
        _check_object(thing, f"{where}, object {thing.get('name', number) if isinstance(thing, dict) else number}")
        if thing["name"] in seen:
            raise ValueError(f"{where}: two objects are called {thing['name']}")
        seen.add(thing["name"])
    for joint in data.get("joints", []):
        _check_joint(joint, seen, f"{where}, joint {joint.get('name')}")
    for tag in data.get("tags", []):
        _positive(tag, "size", 1, f"{where}, tag {tag.get('id')}")
        _vector(tag, "position", 3, f"{where}, tag {tag.get('id')}")
    goal = data.get("goal")
    if goal and goal.get("object") not in seen:
        raise ValueError(f"{where}: the goal's object {goal.get('object')!r} is none of {', '.join(sorted(seen))}")
    for i, point in enumerate((data.get("motion") or {}).get("via", [])):
        _vector({"via": point}, "via", 3, f"{where}, via point {i}")


def _check_object(thing: dict, where: str) -> None:
    missing = [key for key in ("name", "shape", "position") if not isinstance(thing, dict) or key not in thing]
    if missing:
        raise ValueError(f"{where}: missing {', '.join(missing)}")
    if thing["shape"] not in SHAPES:
        raise ValueError(f"{where}: shape {thing['shape']!r} is none of {', '.join(SHAPES)}")
    for key, count in SHAPES[thing["shape"]].items():
        if key == "file":
            if not Path(str(thing.get("file", ""))).is_file():
                raise ValueError(f"{where}: no such mesh file {thing.get('file')!r}")
        else:
            _positive(thing, key, count, where)
    _vector(thing, "position", 3, where)
    _vector({"rpy_deg": thing.get("rpy_deg", [0, 0, 0])}, "rpy_deg", 3, where)
    mass = thing.get("mass", 0)
    if not isinstance(mass, int | float) or not 0 <= mass < math.inf:
        raise ValueError(f"{where}: mass {mass!r} is not a number of kilograms, 0 for fixed")
    if thing.get("texture", "wood") not in TEXTURES:
        raise ValueError(f"{where}: texture {thing['texture']!r} is none of {', '.join(TEXTURES)}")


def _check_joint(joint: dict, objects: set[str], where: str) -> None:
    if joint.get("type") not in JOINTS:
        raise ValueError(f"{where}: type {joint.get('type')!r} is none of {', '.join(JOINTS)}")
    for end in ("parent", "child"):
        if joint.get(end) not in objects:
            raise ValueError(f"{where}: its {end} {joint.get(end)!r} is not an object")
    _vector(joint, "axis", 3, where)


def _vector(thing: dict, key: str, count: int, where: str) -> list[float]:
    value = thing.get(key)
    values = value if isinstance(value, list | tuple) else [value]
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x) for x in values)
    if len(values) != count or not numbers:
        raise ValueError(f"{where}: {key} must be {count} finite number{'s' if count > 1 else ''}, not {value!r}")
    return [float(x) for x in values]


def _positive(thing: dict, key: str, count: int, where: str) -> None:
    if min(_vector(thing, key, count, where)) <= 0:
        raise ValueError(f"{where}: {key} must be positive, not {thing[key]!r}")


def varied(data: dict) -> dict:
    """The world under its seed: everything but the robot and where its hand starts is moved and turned about ``view.target``."""
    data = copy.deepcopy(data)
    variation = data.get("variation") or {}
    if not data.get("seed") or not variation:
        return data
    rng = np.random.default_rng(data["seed"])
    shift = rng.uniform(-1, 1, 3) * variation.get("shift", [0, 0, 0])
    yaw = np.radians(rng.uniform(-1, 1) * variation.get("yaw_deg", 0))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    centre = np.array(data["view"]["target"], dtype=float)

    def moved(point):
        return (turn @ (np.array(point, dtype=float) - centre) + centre + shift).tolist()

    for thing in (*data["objects"], *data.get("tags", [])):
        thing["position"] = moved(thing["position"])
        roll, pitch, old = thing.get("rpy_deg", [0, 0, 0])
        thing["rpy_deg"] = [roll, pitch, old + float(np.degrees(yaw))]
    for view in data.get("sketch_views", []):
        view["eye"], view["target"] = moved(view["eye"]), moved(view["target"])
    via = data["motion"]["via"]
    data["motion"]["via"] = [via[0], *map(moved, via[1:])]
    data["goal"]["approach"] = (turn @ data["goal"]["approach"]).tolist()
    data["view"]["target"] = moved(centre)
    return data


def pre_grasp(data: dict) -> np.ndarray:
    """Where the tip ends (3,) [m]: before the goal's object along the approach."""
    goal = data["goal"]
    (thing,) = (thing for thing in data["objects"] if thing["name"] == goal["object"])
    approach = np.array(goal["approach"], dtype=float)
    return np.array(thing["position"]) - goal["distance"] * approach / np.linalg.norm(approach)
