"""Textured meshes: the skin of a thing or a tag, as an OBJ file and its picture.

Every face has its own part of one picture (an atlas), painted at the same number of pixels per metre.
"""

from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import cv2
import numpy as np

from robot import textures
from robot import thing as things

PIXELS_PER_METRE = 450.0
MOST_PIXELS = 1536
SEGMENTS = 48
MARGIN = 2
SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


@dataclass(frozen=True)
class Skin:
    """pictures: of the faces. quads: (number of its picture, corners (4, 3) [m], anticlockwise seen from outside, their
    places (4, 2) in the picture, from its lower left corner (0, 0) to its upper right (1, 1))."""

    pictures: list[np.ndarray]
    quads: list[tuple[int, np.ndarray, np.ndarray]]

    def moved(self, pose) -> "Skin":
        """By a rigid transform (4, 4)."""
        return Skin(self.pictures, [(k, corners @ pose[:3, :3].T + pose[:3, 3], places) for k, corners, places in self.quads])

    def with_(self, other: "Skin") -> "Skin":
        """Both as one."""
        first = len(self.pictures)
        return Skin(self.pictures + other.pictures, self.quads + [(first + k, *rest) for k, *rest in other.quads])

    def mesh(self) -> tuple[str, np.ndarray]:
        """OBJ text and atlas."""
        atlas, placed = _stack(self.pictures)
        lower, upper = np.array(placed)[:, :2], np.array(placed)[:, 2:]
        return _obj([c for _, c, _ in self.quads], [lower[k] + (upper[k] - lower[k]) * uv for k, _, uv in self.quads]), atlas


def paint(thing: dict, rng) -> tuple[str, np.ndarray]:
    """OBJ text and atlas of a thing as a world's file describes it (robot.thing)."""
    return _skin(thing, rng, "wood", [170, 130, 90]).mesh()


def _skin(thing, rng, texture, colour) -> Skin:
    texture, colour = thing.get("texture", texture), np.array(thing.get("colour", colour), dtype=float)
    if thing["shape"] == "box":
        return _box(thing["size"], texture, rng, colour)
    if thing["shape"] == "cylinder":
        return _cylinder(thing["height"], thing["radius"], texture, rng, colour)
    if thing["shape"] == "cup":
        return _cup(thing["height"], thing["radius"], thing["wall"], texture, rng, colour)
    if thing["shape"] == "crate":
        return _together([_box(size, texture, rng, colour).moved(pose) for _, size, pose in things.primitives(thing)])
    return _together([_skin(part, rng, texture, colour).moved(things.pose(part)) for part in thing["parts"]])


def _together(skins) -> Skin:
    return reduce(Skin.with_, skins)


def box(size, kind, rng, colour) -> tuple[str, np.ndarray]:
    """OBJ text and atlas of a box of full lengths ``size`` (3,) [m] about its centre."""
    return _box(size, kind, rng, colour).mesh()


def cylinder(height, radius, kind, rng, colour) -> tuple[str, np.ndarray]:
    """OBJ text and atlas of a cylinder about its centre, its axis along z."""
    return _cylinder(height, radius, kind, rng, colour).mesh()


def _box(size, kind, rng, colour) -> Skin:
    x, y, z = np.asarray(size, dtype=float) / 2
    faces = [  # +x, -x, +y, -y, +z, -z
        [(x, -y, -z), (x, y, -z), (x, y, z), (x, -y, z)],
        [(-x, y, -z), (-x, -y, -z), (-x, -y, z), (-x, y, z)],
        [(x, y, -z), (-x, y, -z), (-x, y, z), (x, y, z)],
        [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z)],
        [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)],
        [(x, -y, -z), (-x, -y, -z), (-x, y, -z), (x, y, -z)],
    ]
    lengths = [(np.linalg.norm(np.subtract(c[1], c[0])), np.linalg.norm(np.subtract(c[3], c[0]))) for c in faces]
    scale = _scale(max(max(pair) for pair in lengths))
    pictures = [textures.paint(kind, rng, round(h * scale), round(w * scale), scale, colour) for w, h in lengths]
    return Skin(pictures, [(k, np.array(corners), SQUARE) for k, corners in enumerate(faces)])


def _cylinder(height, radius, kind, rng, colour) -> Skin:
    pictures = [_around(height, radius, kind, rng, colour), _lid(height, radius, "metal", rng, np.array([170, 170, 165]))]
    quads = _side(0, height, radius)
    for z, turn in ((height / 2, 1), (-height / 2, -1)):
        quads += _disc(1, radius, z, turn)
    return Skin(pictures, quads)


def _cup(height, radius, wall, kind, rng, colour) -> Skin:
    """Outside, inside, the floor from above and below, and the rim."""
    room = radius - wall
    pictures = [_around(height, radius, kind, rng, colour), _around(height, room, "enamel", rng, 0.5 * colour + 115),
                _lid(height, radius, "enamel", rng, 0.5 * colour + 105)]  # fmt: skip
    inside = [(k, corners[::-1], uv[::-1]) for k, corners, uv in _side(1, height, room)]
    ring = _ring()
    rim = [(2, np.array([(*(room * p), height / 2), (*(radius * p), height / 2), (*(radius * q), height / 2), (*(room * q), height / 2)]),
            0.5 * SQUARE) for p, q in zip(ring[:-1], ring[1:])]  # fmt: skip
    return Skin(pictures, _side(0, height, radius) + inside + rim + _disc(2, room, wall - height / 2, 1) + _disc(2, radius, -height / 2, -1))


def _ring() -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, SEGMENTS + 1)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _side(picture, height, radius) -> list:
    ring, z = radius * _ring(), height / 2
    return [
        (picture, np.array([(*a, -z), (*b, -z), (*b, z), (*a, z)]), (SQUARE + [k, 0]) / [SEGMENTS, 1])
        for k, (a, b) in enumerate(zip(ring[:-1], ring[1:]))
    ]


def _disc(picture, radius, z, turn) -> list:
    """Seen from above (turn 1) or from below (-1)."""
    ring = _ring()[::turn]
    return [
        (picture, np.array([(0, 0, z), (*(radius * p), z), (*(radius * q), z), (0, 0, z)]), (np.array([(0, 0), p, q, (0, 0)]) + 1) / 2)
        for p, q in zip(ring[:-1], ring[1:])
    ]


def _round_scale(height, radius) -> float:
    longest = max(2 * np.pi * radius, height)
    return _scale(longest) if longest > 0.4 else 2 * PIXELS_PER_METRE


def _around(height, radius, kind, rng, colour) -> np.ndarray:
    scale = _round_scale(height, radius)
    return textures.paint(kind, rng, round(height * scale), round(2 * np.pi * radius * scale), scale, colour)


def _lid(height, radius, kind, rng, colour) -> np.ndarray:
    scale = _round_scale(height, radius)
    return textures.paint(kind, rng, round(2 * radius * scale), round(2 * radius * scale), scale, colour)


def tag(number: int, size: float, pixels_per_cell: int = 24) -> tuple[str, np.ndarray]:
    """OBJ text and picture of an upright AprilTag 36h11 with its white border; ``size`` [m] is the black square's edge."""
    picture = np.repeat(np.repeat(tag_cells(number), pixels_per_cell, axis=0), pixels_per_cell, axis=1)
    half = size / 8 * 10 / 2
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    return Skin([np.repeat(picture[..., None], 3, axis=2)], [(0, np.array(corners), SQUARE)]).mesh()


def tag_cells(number: int) -> np.ndarray:
    """(10, 10) uint8, the official upright picture: white border, black frame, 6 x 6 data cells.

    OpenCV draws the family turned by 180 degrees.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    if not 0 <= number < len(dictionary.bytesList):
        raise ValueError(f"there is no AprilTag 36h11 of number {number}; the family has {len(dictionary.bytesList)}")
    inner = cv2.aruco.generateImageMarker(dictionary, number, 8, borderBits=1).reshape(8, 8)[::-1, ::-1]
    return np.pad(inner, 1, constant_values=255)


def save(folder: Path, name: str, obj: str, atlas: np.ndarray) -> tuple[str, str]:
    """Write both; returns the paths of the mesh and the picture."""
    mesh, picture = folder / f"{name}.obj", folder / f"{name}.png"
    mesh.write_text(obj)
    cv2.imwrite(str(picture), atlas[..., ::-1])
    return str(mesh), str(picture)


def _scale(longest: float) -> float:
    return min(PIXELS_PER_METRE, MOST_PIXELS / longest)


def _stack(pictures) -> tuple[np.ndarray, list[tuple[float, float, float, float]]]:
    """Pictures one under the other, and where each lies: (u0, v0, u1, v1), v upwards as OBJ has it."""
    padded = [np.pad(p, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)), mode="edge") for p in pictures]
    width = max(p.shape[1] for p in padded)
    atlas = np.concatenate([np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0)), mode="edge") for p in padded])
    places, top = [], 0
    for picture, outer in zip(pictures, padded):
        v1 = 1 - (top + MARGIN) / len(atlas)
        v0 = 1 - (top + MARGIN + picture.shape[0]) / len(atlas)
        places.append((MARGIN / width, v0, (MARGIN + picture.shape[1]) / width, v1))
        top += outer.shape[0]
    return atlas, places


def _obj(quads, uvs) -> str:
    """OBJ text of quads: (Q, 4) corners in space, (Q, 4) in the picture, flat normals."""
    lines, count = [], 0
    for corners, places in zip(quads, uvs, strict=True):
        normal = np.cross(np.subtract(corners[1], corners[0]), np.subtract(corners[2], corners[0]))
        normal = normal / np.linalg.norm(normal)
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
        lines += [f"vt {u:.6f} {v:.6f}" for u, v in places]
        lines += ["vn {:.6f} {:.6f} {:.6f}".format(*normal)] * 4
        a, b, c, d = (f"{count + k}/{count + k}/{count + k}" for k in (1, 2, 3, 4))
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
        count += 4
    return "\n".join(lines) + "\n"
