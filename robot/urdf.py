"""URDF files as plain values: links, joints and collision shapes, read without a simulator.

Only what kinematics and collision need is read. Lengths in metres, angles in radians. A link's shapes are given in the
link's frame; a joint's origin is ``parent_from_joint``. Meshes are named here and read where they are needed.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision shape. kind: box (full lengths x, y, z) | cylinder, capsule (radius, length along z) | sphere
    (radius) | mesh (scale).

    size: the numbers above [m]. link_from_shape: (4, 4). mesh: the file of a mesh.
    """

    kind: str
    size: np.ndarray
    link_from_shape: np.ndarray
    mesh: Path | None = None


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint and the link it carries. lower, upper [rad or m], velocity [per s]: infinite where the file is silent."""

    name: str
    kind: str
    parent: str
    child: str
    parent_from_joint: np.ndarray
    axis: np.ndarray
    lower: float
    upper: float
    velocity: float


@dataclass(frozen=True, eq=False)
class Urdf:
    """A robot's tree. links: {name: shapes}, parents before children. joints: {child link: Joint}."""

    path: Path
    links: dict[str, tuple[Shape, ...]]
    joints: dict[str, Joint]

    @classmethod
    def load(cls, path) -> "Urdf":
        """Read a URDF file. FileNotFoundError when absent; ValueError when it is no tree with finite numbers."""
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"no URDF at {path}")
        try:
            root = ElementTree.parse(path).getroot()
        except ElementTree.ParseError as error:
            raise ValueError(f"{path.name} is not readable as URDF: {error}") from error
        try:
            shapes = {link.attrib["name"]: _shapes(link, path.parent) for link in root.findall("link")}
            joints = {joint.child: joint for joint in map(_joint, root.findall("joint"))}
        except (KeyError, TypeError) as error:
            raise ValueError(f"{path.name}: an element lacks what URDF asks for: {error}") from error
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from error
        return cls(path, {name: shapes[name] for name in _topological(shapes, joints, path.name)}, joints)

    def chain(self, link: str) -> list[str]:
        """Links from the root to ``link``, both included."""
        names = [link]
        while names[-1] in self.joints:
            names.append(self.joints[names[-1]].parent)
        return names[::-1]


def _topological(links, joints, file) -> list[str]:
    for joint in joints.values():
        for name in (joint.parent, joint.child):
            if name not in links:
                raise ValueError(f"{file}: joint {joint.name} names the link {name}, which is not there")
    ordered = [name for name in links if name not in joints]
    if len(ordered) != 1:
        raise ValueError(f"{file}: a robot is one tree of links; found {len(ordered)} roots {ordered}")
    for name in ordered:  # grows while it is read
        ordered.extend(child for child, joint in joints.items() if joint.parent == name)
    return ordered


def _joint(element) -> Joint:
    name, kind = element.attrib["name"], element.attrib["type"]
    if kind not in (*MOVING, "fixed"):
        raise ValueError(f"joint {name} is of type {kind}; known are {', '.join(MOVING)} and fixed")
    axis_element, limit = element.find("axis"), element.find("limit")
    axis = np.array([1.0, 0, 0]) if axis_element is None else _numbers(axis_element.attrib["xyz"], 3, f"axis of {name}")
    if kind != "fixed":
        if np.linalg.norm(axis) < 1e-9:
            raise ValueError(f"joint {name} moves along the axis {axis}, which has no direction")
        axis = axis / np.linalg.norm(axis)
    bounds = {} if limit is None else limit.attrib
    lower, upper, velocity = (
        float(_numbers(bounds[key], 1, f"{key} of {name}")[0]) if key in bounds else default
        for key, default in (("lower", -np.inf), ("upper", np.inf), ("velocity", np.inf))
    )
    if kind == "continuous":
        lower, upper = -np.inf, np.inf
    if lower > upper:
        raise ValueError(f"joint {name}: lower limit {lower} is above the upper limit {upper}")
    parent, child = element.find("parent").attrib["link"], element.find("child").attrib["link"]
    return Joint(name, kind, parent, child, _origin(element), axis, lower, upper, velocity)


def _shapes(link, folder) -> tuple[Shape, ...]:
    return tuple(_shape(collision, folder, link.attrib["name"]) for collision in link.findall("collision"))


def _shape(collision, folder, link) -> Shape:
    geometry = collision.find("geometry")[0]
    kind, given = geometry.tag, geometry.attrib
    if kind == "box":
        size = _numbers(given["size"], 3, f"box of {link}")
    elif kind in ("cylinder", "capsule"):
        size = _numbers(f"{given['radius']} {given['length']}", 2, f"{kind} of {link}")
    elif kind == "sphere":
        size = _numbers(given["radius"], 1, f"sphere of {link}")
    elif kind == "mesh":
        size = _numbers(given.get("scale", "1 1 1"), 3, f"mesh of {link}")
        return Shape(kind, size, _origin(collision), _mesh_path(given["filename"], folder))
    else:
        raise ValueError(f"link {link} has a collision shape {kind}; known are box, cylinder, capsule, sphere, mesh")
    if (size <= 0).any():
        raise ValueError(f"the {kind} of link {link} has a size that is not positive: {size}")
    return Shape(kind, size, _origin(collision))


def _mesh_path(filename, folder) -> Path:
    """package://a/b is looked for in the URDF's folder and those above it, as PyBullet does."""
    relative = filename.removeprefix("package://").removeprefix("file://")
    found = next((f / relative for f in (folder, *list(folder.parents)[:3]) if (f / relative).is_file()), None)
    if found is None:
        raise FileNotFoundError(f"the mesh {filename} is not beside its URDF in {folder}")
    return found


def _numbers(text, count, what) -> np.ndarray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise ValueError(f"{what}: {text!r} are not numbers") from error
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{what}: {text!r} should be {count} finite number{'s' * (count > 1)}")
    return values


def _origin(element) -> np.ndarray:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _numbers(origin.attrib.get("rpy", "0 0 0"), 3, "rpy of an origin")
    pose = np.eye(4)
    pose[:3, :3] = _about("z", yaw) @ _about("y", pitch) @ _about("x", roll)
    pose[:3, 3] = _numbers(origin.attrib.get("xyz", "0 0 0"), 3, "xyz of an origin")
    return pose


def _about(axis, angle) -> np.ndarray:
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = np.cos(angle)
    R[k, j] = np.sin(angle)
    R[j, k] = -R[k, j]
    return R
