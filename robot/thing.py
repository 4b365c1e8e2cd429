"""One thing of a world: what a file may say of it, and the primitives that it consists of.

    box       size [m]                    cylinder  height, radius [m], its axis along z
    crate     size, wall [m]              an open-topped box of five boards
    cup       height, radius, wall [m]    an open-topped round vessel: a round floor and WALLS flat staves
    parts     a list of things, each with a position and rpy_deg in this one's frame; they move as one
    mesh      file                        an OBJ file; it collides as its convex hull

A thing's frame lies in the middle of its size; of ``parts``, where their frame is.
"""

import math
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robot.fields import known, mappings, near, positive, vector

SHAPES = {
    "box": {"size": 3},
    "cylinder": {"height": 1, "radius": 1},
    "crate": {"size": 3, "wall": 1},
    "cup": {"height": 1, "radius": 1, "wall": 1},
    "mesh": {"file": 0},
    "parts": {"parts": 0},
}
TEXTURES = ("wood", "cardboard", "label", "concrete", "metal", "enamel", "paper")
LOOK = {"texture", "colour"}
KEYS = {"name", "shape", "position", "rpy_deg", "mass", "friction", *LOOK}.union(*SHAPES.values())
WALLS = 12
MOST = 16  # primitives of one body; PyBullet silently leaves out those beyond


def check(thing, where: str) -> None:
    """Raise ValueError at the first field that is wrong."""
    if not isinstance(thing, dict):
        raise ValueError(f"{where}: an object is a mapping with name, shape and position, not {thing!r}")
    missing = [key for key in ("name", "shape", "position") if key not in thing]
    if missing:
        raise ValueError(f"{where}: missing {', '.join(missing)}")
    known(map(str, thing), KEYS, where)
    if not isinstance(thing["name"], str):
        raise ValueError(f"{where}: name must be text, not {thing['name']!r}")
    _check_shape(thing, where)
    vector(thing, "position", 3, where)
    vector({"rpy_deg": thing.get("rpy_deg", [0, 0, 0])}, "rpy_deg", 3, where)
    mass = thing.get("mass", 0)
    if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0 <= mass < math.inf:
        raise ValueError(f"{where}: mass {mass!r} is not a number of kilograms, 0 for fixed")
    if thing.get("texture", "wood") not in TEXTURES:
        raise ValueError(f"{where}: texture {thing['texture']!r} is none of {', '.join(TEXTURES)}")
    if not all(0 <= c <= 255 for c in vector({"colour": thing.get("colour", [0, 0, 0])}, "colour", 3, where)):
        raise ValueError(f"{where}: colour must lie in 0 .. 255, not {thing['colour']!r}")
    if vector({"friction": thing.get("friction", 0)}, "friction", 1, where)[0] < 0:
        raise ValueError(f"{where}: friction must not be negative, not {thing['friction']!r}")


def _check_shape(thing: dict, where: str) -> None:
    shape = thing["shape"]
    if not isinstance(shape, str) or shape not in SHAPES:
        raise ValueError(f"{where}: unknown shape {shape!r}{near(shape, SHAPES)}")
    for key, count in SHAPES[shape].items():
        if count:
            positive(thing, key, count, where)
    if shape in ("crate", "cup"):
        narrowest = min(thing["size"]) if shape == "crate" else min(2 * thing["radius"], thing["height"])
        if 2 * thing["wall"] >= narrowest:
            raise ValueError(f"{where}: a wall of {thing['wall']} m leaves no room inside {narrowest} m")
    if shape == "mesh" and not Path(str(thing.get("file", ""))).is_file():
        raise ValueError(f"{where}: no such mesh file {thing.get('file')!r}")
    if shape == "parts":
        if not mappings(thing, "parts", where):
            raise ValueError(f"{where}: parts needs at least one part")
        for k, part in enumerate(thing["parts"]):
            if part.get("shape") in ("parts", "mesh"):
                raise ValueError(f"{where}, part {k}: a part cannot be of shape {part['shape']}")
            check({"name": f"part {k}"} | part, f"{where}, part {k}")
        if len(primitives(thing)) > MOST:
            raise ValueError(f"{where}: its parts consist of {len(primitives(thing))} primitives, {MOST} at most; make it two things")


def pose(thing: dict) -> np.ndarray:
    """(4, 4) of the thing in the frame that its position is given in."""
    return placed(thing["position"], thing.get("rpy_deg", [0, 0, 0]))


def placed(position, rpy_deg=(0, 0, 0)) -> np.ndarray:
    """(4, 4) from a position [m] and angles about the fixed axes x, y, z, in that order."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix()
    matrix[:3, 3] = position
    return matrix


def primitives(thing: dict) -> list[tuple[str, list[float], np.ndarray]]:
    """(kind, size, thing_from_primitive (4, 4)) of each: "box" with full lengths, or "cylinder" with radius and length.

    A mesh consists of none.
    """
    if thing["shape"] == "box":
        return [("box", list(thing["size"]), np.eye(4))]
    if thing["shape"] == "cylinder":
        return [("cylinder", [thing["radius"], thing["height"]], np.eye(4))]
    if thing["shape"] == "crate":
        return _boards(*thing["size"], thing["wall"])
    if thing["shape"] == "cup":
        return _staves(thing["height"], thing["radius"], thing["wall"])
    parts = thing.get("parts", [])
    return [(kind, size, pose(part) @ own) for part in parts for kind, size, own in primitives(part)]


def _boards(x, y, z, wall):
    """A floor, two walls across x, and two between them."""
    return [
        ("box", [x, y, wall], placed([0, 0, (wall - z) / 2])),
        *(("box", [wall, y, z - wall], placed([side * (x - wall) / 2, 0, wall / 2])) for side in (-1, 1)),
        *(("box", [x - 2 * wall, wall, z - wall], placed([0, side * (y - wall) / 2, wall / 2])) for side in (-1, 1)),
    ]


def _staves(height, radius, wall):
    """A round floor, and walls whose outsides touch the cylinder from within."""
    angles = 360 * np.arange(WALLS) / WALLS
    middle, width = radius * np.cos(np.pi / WALLS) - wall / 2, 2 * radius * np.sin(np.pi / WALLS)
    floor = ("cylinder", [radius - wall, wall], placed([0, 0, (wall - height) / 2]))
    around = [placed([0, 0, 0], [0, 0, a]) @ placed([middle, 0, 0]) for a in angles]
    return [floor, *(("box", [wall, width, height], stave) for stave in around)]


def interior(thing: dict) -> tuple[np.ndarray, bool]:
    """Half lengths (3,) [m] of the room inside a crate or cup, in its frame, and whether it is round about z."""
    if thing["shape"] == "crate":
        return np.array(thing["size"]) / 2 - np.array([thing["wall"], thing["wall"], 0]), False
    return np.array([thing["radius"] - thing["wall"]] * 2 + [thing["height"] / 2]), True
