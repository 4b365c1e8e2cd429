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
    variation: {shift [m], yaw_deg, stays: [names]}     half ranges; ``stays`` stand with the robot (its pedestal, the floor)
    film: {eye, target, fov_deg}     where the performance is filmed from (optional)

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
KEYS = {"name", "shape", "size", "height", "radius", "file", "position", "rpy_deg", "mass", "friction", "texture", "colour"}
TAGS = 587  # in the family 36h11


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
    for joint in _mappings(data, "joints", where):
        _check_joint(joint, seen, f"{where}, joint {joint.get('name')}")
    _check_tags(_mappings(data, "tags", where), where)
    _check_task(data, seen, where)
    _check_variation(data, where)


def _mappings(data: dict, key: str, where: str) -> list[dict]:
    """The list of mappings under ``key``; empty where there is none."""
    value = data.get(key, [])
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        raise ValueError(f"{where}: {key} must be a list of mappings, not {value!r}")
    return value


def _check_tags(tags: list[dict], where: str) -> None:
    for tag in tags:
        number = tag.get("id")
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < TAGS:
            raise ValueError(f"{where}: a tag's id must be a number from 0 to {TAGS - 1}, not {number!r}")
        _positive(tag, "size", 1, f"{where}, tag {number}")
        _vector(tag, "position", 3, f"{where}, tag {number}")
        _vector({"rpy_deg": tag.get("rpy_deg", [0, 0, 0])}, "rpy_deg", 3, f"{where}, tag {number}")
    if len({tag["id"] for tag in tags}) < len(tags) or len({float(tag["size"]) for tag in tags}) > 1:
        raise ValueError(f"{where}: tags must have different ids and one size")


def _check_task(data: dict, objects: set[str], where: str) -> None:
    """What is looked at, meant, and judged."""
    for key in ("view", "workspace", "motion", "goal", "success", "film"):
        if data.get(key) is not None and not isinstance(data[key], dict):
            raise ValueError(f"{where}: {key} must be a mapping, not {data[key]!r}")
    for i, point in enumerate((data.get("motion") or {}).get("via", [])):
        _vector({"via": point}, "via", 3, f"{where}, via point {i}")
    for i, view in enumerate(_mappings(data, "sketch_views", where)):
        _check_view(view, f"{where}, sketch view {i}")
    if data.get("film"):
        _check_view(data["film"], f"{where}, film")
    if data.get("view"):
        _vector(data["view"], "target", 3, f"{where}, view")
    if data.get("goal"):
        _check_goal(data["goal"], objects, where)
    success = {"reached_m": 0.05, "contacts": 0} | (data.get("success") or {})
    for key in ("reached_m", "contacts"):
        if _vector(success, key, 1, f"{where}, success")[0] < 0:
            raise ValueError(f"{where}, success: {key} must not be negative, not {success[key]!r}")


def _check_goal(goal: dict, objects: set[str], where: str) -> None:
    if goal.get("object") not in objects:
        raise ValueError(f"{where}: the goal's object {goal.get('object')!r} is none of {', '.join(sorted(objects))}")
    if not any(_vector(goal, "approach", 3, f"{where}, goal")):
        raise ValueError(f"{where}, goal: approach must have a direction, not {goal['approach']!r}")
    _vector(goal, "distance", 1, f"{where}, goal")


def _check_view(view: dict, where: str) -> None:
    if _vector(view, "eye", 3, where) == _vector(view, "target", 3, where):
        raise ValueError(f"{where}: eye and target are the same point")
    if not 0 < _vector(view, "fov_deg", 1, where)[0] < 180:
        raise ValueError(f"{where}: fov_deg must lie between 0 and 180, not {view['fov_deg']!r}")


def _check_variation(data: dict, where: str) -> None:
    seed, variation = data.get("seed", 0), data.get("variation") or {}
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ValueError(f"{where}: seed must be a whole number, 0 for the world as published, not {seed!r}")
    if not isinstance(variation, dict):
        raise ValueError(f"{where}: variation must be a mapping, not {variation!r}")
    _vector({"shift": variation.get("shift", [0, 0, 0])}, "shift", 3, f"{where}, variation")
    _vector({"yaw_deg": variation.get("yaw_deg", 0)}, "yaw_deg", 1, f"{where}, variation")
    if seed and variation and not data.get("view"):
        raise ValueError(f"{where}: a world that varies needs a view with the target that it turns about")


def _check_object(thing: dict, where: str) -> None:
    missing = [key for key in ("name", "shape", "position") if not isinstance(thing, dict) or key not in thing]
    if missing:
        raise ValueError(f"{where}: missing {', '.join(missing)}")
    unknown = sorted(set(map(str, thing)) - KEYS)
    if unknown:
        raise ValueError(f"{where}: unknown {', '.join(unknown)}; there are {', '.join(sorted(KEYS))}")
    if not isinstance(thing["name"], str):
        raise ValueError(f"{where}: name must be text, not {thing['name']!r}")
    if not isinstance(thing["shape"], str) or thing["shape"] not in SHAPES:
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
    if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0 <= mass < math.inf:
        raise ValueError(f"{where}: mass {mass!r} is not a number of kilograms, 0 for fixed")
    if thing.get("texture", "wood") not in TEXTURES:
        raise ValueError(f"{where}: texture {thing['texture']!r} is none of {', '.join(TEXTURES)}")
    if not all(0 <= c <= 255 for c in _vector({"colour": thing.get("colour", [0, 0, 0])}, "colour", 3, where)):
        raise ValueError(f"{where}: colour must lie in 0 .. 255, not {thing['colour']!r}")
    if _vector({"friction": thing.get("friction", 0)}, "friction", 1, where)[0] < 0:
        raise ValueError(f"{where}: friction must not be negative, not {thing['friction']!r}")


def _check_joint(joint: dict, objects: set[str], where: str) -> None:
    if joint.get("type") not in JOINTS:
        raise ValueError(f"{where}: type {joint.get('type')!r} is none of {', '.join(JOINTS)}")
    for end in ("parent", "child"):
        if joint.get(end) not in objects:
            raise ValueError(f"{where}: its {end} {joint.get(end)!r} is not an object")
    if not any(_vector(joint, "axis", 3, where)):
        raise ValueError(f"{where}: axis must have a direction, not {joint['axis']!r}")


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
    """The world under its seed: moved and turned about ``view.target``, but for the robot, where its hand starts, and what stays."""
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

    stays = variation.get("stays", [])
    for thing in (*(t for t in data["objects"] if t["name"] not in stays), *data.get("tags", [])):
        thing["position"] = moved(thing["position"])
        roll, pitch, old = thing.get("rpy_deg", [0, 0, 0])
        thing["rpy_deg"] = [roll, pitch, old + float(np.degrees(yaw))]
    for view in data.get("sketch_views", []):
        view["eye"], view["target"] = moved(view["eye"]), moved(view["target"])
    if data.get("film"):
        data["film"]["eye"], data["film"]["target"] = moved(data["film"]["eye"]), moved(data["film"]["target"])
    if data.get("motion"):
        via = data["motion"]["via"]
        data["motion"]["via"] = [via[0], *map(moved, via[1:])]
    if data.get("goal"):
        data["goal"]["approach"] = (turn @ data["goal"]["approach"]).tolist()
    data["view"]["target"] = moved(centre)
    return data


def pre_grasp(data: dict) -> np.ndarray:
    """Where the tip ends (3,) [m]: before the goal's object along the approach."""
    goal = data["goal"]
    (thing,) = (thing for thing in data["objects"] if thing["name"] == goal["object"])
    approach = np.array(goal["approach"], dtype=float)
    return np.array(thing["position"]) - goal["distance"] * approach / np.linalg.norm(approach)
