"""Collision geometry: convex pieces, each as an exact FCL geometry and as a few balls that cover it.

A piece is a box, cylinder, capsule, sphere, or the convex hull of a mesh (what PyBullet makes of a mesh too). Lengths
in metres. ``frame_from_piece`` (4, 4) places it: the frame is a link's for robots, the world's for the things around
them.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import fcl
import numpy as np
import trimesh
from scipy.cluster.vq import kmeans2
from scipy.spatial import ConvexHull

from robot.bullet import pybullet

BOX, CYLINDER, CAPSULE, SPHERE = 0, 1, 2, 3
BALLS = 12
PLANE_SIZE = 10.0  # m: a plane is the top of a slab of this width


@dataclass(frozen=True, eq=False)
class Piece:
    """name: the link or body it belongs to. bound, size: a primitive that contains it (itself, where it is one): box
    (half lengths), cylinder and capsule (radius, half length), sphere (radius). vertices (V, 3): a polytope that
    contains it."""

    name: str
    geometry: fcl.CollisionGeometry
    bound: int
    size: np.ndarray
    vertices: np.ndarray
    frame_from_piece: np.ndarray

    def cover(self) -> np.ndarray:
        """Balls (B, 4): centre in the frame and radius [m], whose union contains the piece."""
        if self.bound == SPHERE:
            return np.append(self.frame_from_piece[:3, 3], self.size[0])[None]
        points, reach = _fill(self.vertices)
        count = min(BALLS, len(points))
        centres, label = kmeans2(points, count, minit="++", seed=0)
        kept = [k for k in range(count) if (label == k).any()]
        radii = [np.linalg.norm(points[label == k] - centres[k], axis=1).max() + reach for k in kept]
        return np.column_stack([transform(self.frame_from_piece, centres[kept]), radii])

    def corners(self) -> np.ndarray:
        """(8, 3) corners, in the frame, of a box that contains the piece."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        box = np.array(
            [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        return transform(self.frame_from_piece, box)


def _fill(vertices, cells=2500) -> tuple[np.ndarray, float]:
    """Grid points such that every point of the hull of ``vertices`` is within the returned distance [m] of one."""
    hull = ConvexHull(vertices)
    step = max(hull.volume / cells, 1e-9) ** (1 / 3)
    reach = step * np.sqrt(3) / 2
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    counts = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    axes = [a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in zip(low, high, counts)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    near = (grid @ hull.equations[:, :3].T + hull.equations[:, 3] <= reach).all(axis=1)
    return grid[near], reach


def transform(pose, points) -> np.ndarray:
    """Points (..., 3) moved by a rigid transform (4, 4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def box(name, lengths, pose) -> Piece:
    half = np.asarray(lengths, dtype=float) / 2
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    return Piece(name, fcl.Box(*(2 * half)), BOX, half, signs * half, pose)


def sphere(name, radius, pose) -> Piece:
    return replace(
        box(name, [2 * radius] * 3, pose), geometry=fcl.Sphere(radius), bound=SPHERE, size=np.array([radius])
    )


def cylinder(name, radius, length, pose) -> Piece:
    size = np.array([radius, length / 2])
    return Piece(name, fcl.Cylinder(radius, length), CYLINDER, size, _prism(radius, length / 2), pose)


def capsule(name, radius, length, pose) -> Piece:
    """``length`` is that of the cylinder between the two half balls."""
    size = np.array([radius, length / 2])
    return Piece(name, fcl.Capsule(radius, length), CAPSULE, size, _prism(radius, length / 2 + radius), pose)


def convex(name, points, pose) -> Piece:
    """The convex hull of points (V, 3). ValueError when they are flat or not finite."""
    points = np.asarray(points, dtype=float)
    if (
        len(points) < 4
        or not np.isfinite(points).all()
        or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6) < 3
    ):
        raise ValueError(f"the mesh of {name} encloses no volume")
    hull = trimesh.convex.convex_hull(points)
    low, high = hull.bounds
    centred = np.array(pose, dtype=float)
    centred[:3, 3] = transform(pose, (low + high) / 2)
    vertices = np.ascontiguousarray(hull.vertices - (low + high) / 2)
    faces = np.column_stack([np.full(len(hull.faces), 3), hull.faces]).ravel()
    return Piece(name, fcl.Convex(vertices, len(hull.faces), faces), BOX, (high - low) / 2, vertices, centred)


def _prism(radius, half, sides=12) -> np.ndarray:
    """Vertices of a prism around a cylinder."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius / np.cos(np.pi / sides) * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-half, half)])


def link_pieces(description) -> list[tuple[int, Piece]]:
    """(index of the link, piece in the link's frame) for every collision shape of a Urdf."""
    return [
        (index, _urdf_piece(name, shape))
        for index, (name, shapes) in enumerate(description.links.items())
        for shape in shapes
    ]


def _urdf_piece(name, shape) -> Piece:
    if shape.kind == "mesh":
        return convex(name, mesh_points(shape.mesh) * shape.size, shape.link_from_shape)
    make = {
        "box": lambda: box(name, shape.size, shape.link_from_shape),
        "sphere": lambda: sphere(name, shape.size[0], shape.link_from_shape),
        "cylinder": lambda: cylinder(name, *shape.size, shape.link_from_shape),
        "capsule": lambda: capsule(name, *shape.size, shape.link_from_shape),
    }
    return make[shape.kind]()


def mesh_points(path) -> np.ndarray:
    if not Path(path).is_file():
        raise FileNotFoundError(f"no mesh at {path}")
    try:
        points = np.asarray(trimesh.load(path, force="mesh", process=False).vertices)
    except Exception as error:  # trimesh raises whatever its reader of that format raises
        raise ValueError(f"the mesh {Path(path).name} cannot be read: {error}") from error
    if not len(points):
        raise ValueError(f"the mesh {Path(path).name} cannot be read: there is no triangle in it")
    return points


def body_pieces(client, bodies) -> list[Piece]:
    """Pieces, in the world's frame, of the bodies {name: PyBullet id} where they stand now."""
    pieces = []
    for name, body in bodies.items():
        for link in range(-1, client.getNumJoints(body)):
            world_from_com = _com_pose(client, body, link)
            for data in client.getCollisionShapeData(body, link) or ():
                pieces.append(_body_piece(client, name, body, link, data, world_from_com))
    return pieces


def region_pieces(regions) -> list[Piece]:
    """The convex pieces of regions (teach.hull.Region), in the world's frame."""
    return [convex(region.name, vertices, np.eye(4)) for region in regions for vertices, _ in region.pieces]


def _com_pose(client, body, link) -> np.ndarray:
    if link < 0:
        position, quat_xyzw = client.getBasePositionAndOrientation(body)
    else:
        position, quat_xyzw = client.getLinkState(body, link, computeForwardKinematics=True)[:2]
    return _matrix(position, quat_xyzw)


def _matrix(position, quat_xyzw) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(quat_xyzw), (3, 3))
    pose[:3, 3] = position
    return pose


def _body_piece(client, name, body, link, data, world_from_com) -> Piece:
    """PyBullet gives shapes in the centre-of-mass frame; cylinders as (length, radius)."""
    _, _, kind, size, file, position, quat_xyzw = data
    pose = world_from_com @ _matrix(position, quat_xyzw)
    if kind == pybullet.GEOM_BOX:
        return box(name, size, pose)
    if kind == pybullet.GEOM_SPHERE:
        return sphere(name, size[0], pose)
    if kind == pybullet.GEOM_CYLINDER:
        return cylinder(name, size[1], size[0], pose)
    if kind == pybullet.GEOM_CAPSULE:
        return capsule(name, size[1], size[0], pose)
    if kind == pybullet.GEOM_PLANE:
        return box(name, [PLANE_SIZE, PLANE_SIZE, 1.0], pose @ _matrix([0, 0, -0.5], [0, 0, 0, 1]))
    if kind == pybullet.GEOM_MESH:
        path = Path(file.decode() if isinstance(file, bytes) else file)
        if path.is_file():
            return convex(name, mesh_points(path) * np.asarray(size), pose)
        return convex(name, client.getMeshData(body, link)[1], world_from_com)  # already scaled and moved there
    raise ValueError(f"{name} has a collision shape of PyBullet's type {kind}, which has no distance here")
