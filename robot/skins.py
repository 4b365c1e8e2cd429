"""Textured meshes: the skin of a box, a cylinder or a tag, as an OBJ file and its picture.

Every face has its own part of one picture (an atlas), painted at the same number of pixels per metre.
"""

from pathlib import Path

import cv2
import numpy as np

from robot import textures

PIXELS_PER_METRE = 450.0
MOST_PIXELS = 1536
SEGMENTS = 48
MARGIN = 2


def box(size, kind, rng, colour) -> tuple[str, np.ndarray]:
    """OBJ text and atlas of a box of full lengths ``size`` (3,) [m] about its centre."""
    x, y, z = np.asarray(size, dtype=float) / 2
    corners = {  # of each face, anticlockwise seen from outside, beginning at the picture's lower left
        "+x": [(x, -y, -z), (x, y, -z), (x, y, z), (x, -y, z)],
        "-x": [(-x, y, -z), (-x, -y, -z), (-x, -y, z), (-x, y, z)],
        "+y": [(x, y, -z), (-x, y, -z), (-x, y, z), (x, y, z)],
        "-y": [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z)],
        "+z": [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)],
        "-z": [(x, -y, -z), (-x, -y, -z), (-x, y, -z), (x, y, -z)],
    }
    lengths = [(np.linalg.norm(np.subtract(c[1], c[0])), np.linalg.norm(np.subtract(c[3], c[0]))) for c in corners.values()]
    scale = _scale(max(max(pair) for pair in lengths))
    faces = [textures.paint(kind, rng, round(h * scale), round(w * scale), scale, colour) for w, h in lengths]
    atlas, places = _stack(faces)
    return _quads(list(corners.values()), places), atlas


def cylinder(height, radius, kind, rng, colour) -> tuple[str, np.ndarray]:
    """OBJ text and atlas of a cylinder about its centre, its axis along z."""
    around = 2 * np.pi * radius
    scale = _scale(max(around, height)) if max(around, height) > 0.4 else 2 * PIXELS_PER_METRE
    side = textures.paint(kind, rng, round(height * scale), round(around * scale), scale, colour)
    lid = textures.paint("metal", rng, round(2 * radius * scale), round(2 * radius * scale), scale, np.array([170, 170, 165]))
    atlas, ((u0, v0, u1, v1), cap) = _stack([side, lid])
    angle = np.linspace(0, 2 * np.pi, SEGMENTS + 1)
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    quads, uvs = [], []
    for k in range(SEGMENTS):
        a, b = (*ring[k],), (*ring[k + 1],)
        quads.append([(*a, -height / 2), (*b, -height / 2), (*b, height / 2), (*a, height / 2)])
        s, e = u0 + (u1 - u0) * k / SEGMENTS, u0 + (u1 - u0) * (k + 1) / SEGMENTS
        uvs.append([(s, v0), (e, v0), (e, v1), (s, v1)])
        for z, (p, q) in ((height / 2, (a, b)), (-height / 2, (b, a))):
            quads.append([(0.0, 0.0, z), (*p, z), (*q, z), (0.0, 0.0, z)])
            uvs.append([_on_lid(point, radius, cap) for point in ((0.0, 0.0), p, q, (0.0, 0.0))])
    return _obj(quads, uvs), atlas


def tag(number: int, size: float, pixels_per_cell: int = 24) -> tuple[str, np.ndarray]:
    """OBJ text and picture of an upright AprilTag 36h11 with its white border; ``size`` [m] is the black square's edge."""
    picture = np.repeat(np.repeat(tag_cells(number), pixels_per_cell, axis=0), pixels_per_cell, axis=1)
    half = size / 8 * 10 / 2
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    atlas, places = _stack([np.repeat(picture[..., None], 3, axis=2)])
    return _quads([corners], places), atlas


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


def _on_lid(point, radius, place) -> tuple[float, float]:
    u0, v0, u1, v1 = place
    return u0 + (u1 - u0) * (point[0] / radius + 1) / 2, v0 + (v1 - v0) * (point[1] / radius + 1) / 2


def _quads(corners, places) -> str:
    return _obj(corners, [[(u0, v0), (u1, v0), (u1, v1), (u0, v1)] for u0, v0, u1, v1 in places])


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
