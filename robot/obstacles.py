"""What the arm must keep clear of when nobody has measured the world: the reconstruction's pieces, and what nobody has
seen.

    collision/*.obj     convex pieces of the mesh                                   (scene.surface)
    space               what of space is free, occupied, unseen                      (scene.surface.space.Space)

What the hand is to touch is told by boxes around it: pieces are cut where they leave a box, and what is inside only the
hand's own links may touch. The table beneath it stays in the way of all. Unseen space counts as occupied within ``near`` of the taught path. Around the arm as it stands at the start it does
not: that it stands there shows that the place is free.

    with World.from_spec(reconstructed(folder, space, path, around)) as world: plan(skill, arm, world)
"""

from itertools import product
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, cKDTree

from robot.keepout import corners_of
from robot.shapes import mesh_points
from robot.standing import thing_pieces

UNSEEN = "unseen"
"""What bodies of unseen space are called, with a number."""
FLAT = 1e-5  # m: what is thinner is no part


def reconstructed(folder: str | Path, space, path, around, *, near: float = 0.25, free: float = 0.25, touch=(), work=None) -> dict:
    """The data of a world (robot.worldfile) of the pieces in ``folder``/collision and of what is unseen near the path.

    space: scene.surface.space.Space or None, when nothing counts as unseen. path: (N, 3) points that the tip may pass; around:
    (M, 3) points on the arm at the start. near: how far from the path unseen space counts as occupied; free: how far
    around the arm it does not [m]. touch: boxes {name, lower, upper} [m] around what the hand is to touch. work: a folder for
    pieces that are cut there, which must last as long as the world. Raises FileNotFoundError where there is no piece. """
    pieces = sorted((Path(folder) / "collision").glob("*.obj"))
    if not pieces:
        where = Path(folder) / "collision"
        raise FileNotFoundError(f"no pieces in {where}: python -m scene.mesh makes them from a trained field")
    touch = [(box["name"], *corners_of(box)) for box in touch]
    meshes = [_mesh(file, *part, work) for file in pieces for part in _parts(file.stem, mesh_points(file), touch)]
    boxes = enumerate(unseen(space, path, around, near, free) if space is not None else [])
    filled = [_box(*part) for i, box in boxes for part in _parts(f"{UNSEEN}{i:03d}", np.array(list(product(*box.T))), touch)]
    objects = [*meshes, *filled]
    touched = [thing["name"] for thing in objects if any(thing["name"].startswith(f"{name}_") for name, _, _ in touch)]
    return {"name": "reconstruction", "objects": objects, "touch": touched}


def around(things, beside: float = 0.02) -> list[dict]:
    """Boxes {name, lower, upper} around things of a world's file where they stand, larger to all sides but below [m]."""
    found = []
    for thing in things:
        corners = np.vstack([piece.corners() for piece in thing_pieces(thing)])
        lower, upper = corners.min(axis=0) - [beside, beside, 0], corners.max(axis=0) + beside
        found.append({"name": thing["name"], "lower": lower.tolist(), "upper": upper.tolist()})
    return found


def _mesh(file: Path, name: str, points, whole: bool, work) -> dict:
    if not whole:
        Path(work).mkdir(parents=True, exist_ok=True)
        file = Path(work) / f"{name}.obj"
        trimesh.convex.convex_hull(points).export(file)
    return {"name": name, "shape": "mesh", "position": [0.0, 0.0, 0.0], "file": str(Path(file).absolute())}


def _box(name: str, points, whole: bool) -> dict:
    lower, upper = points.min(axis=0), points.max(axis=0)
    return {"name": name, "shape": "box", "size": (upper - lower).tolist(), "position": ((lower + upper) / 2).tolist()}


def _parts(name: str, points, boxes) -> list[tuple[str, np.ndarray, bool]]:
    """(name, corners (V, 3), whether it is whole) of the parts of a convex piece that lie in each of the boxes (name, lower, upper),
    called after that, and of what is left."""
    left, inside = [points], []
    for box, lower, upper in boxes:
        outside = []
        for part in left:
            within, beside = split(part, lower, upper)
            inside += [(f"{box}_{name}", within, False)] * (within is not None)
            outside += beside
        left = outside
    whole = len(left) == 1 and not inside
    return inside + [(name if whole else f"{name}_{k}", part, whole) for k, part in enumerate(left)]


def split(points, lower, upper) -> tuple[np.ndarray | None, list[np.ndarray]]:
    """The corners of the part of a convex piece, of corners (V, 3), inside a box (None where there is none), and those of the
    convex parts outside, up to six."""
    if (points.max(axis=0) < lower).any() or (points.min(axis=0) > upper).any():
        return None, [points]
    inside, outside = points, []
    for axis in range(3):
        for sign, bound in ((1.0, upper[axis]), (-1.0, lower[axis])):
            far = _half(inside, axis, -sign, bound)
            inside = _half(inside, axis, sign, bound)
            outside += [far] * (far is not None)
            if inside is None:
                return None, [points]
    return inside, outside


def _half(points, axis, sign, bound) -> np.ndarray | None:
    """Corners of the part of a convex piece where sign * (x[axis] - bound) <= 0; None where it is flat."""
    depth = sign * (points[:, axis] - bound)
    under, over = points[depth <= 0], points[depth > 0]
    if not len(over):
        return points
    if not len(under) or depth.min() > -FLAT:
        return None
    d, e = -depth[depth <= 0][:, None, None], depth[depth > 0][None, :, None]
    met = (e * under[:, None] + d * over[None]) / (d + e)  # where the segments between both cross the plane
    corners = np.vstack([under, met.reshape(-1, 3)])
    return corners[ConvexHull(corners).vertices]


def unseen(space, path, around, near: float, free: float) -> np.ndarray:
    """(B, 2, 3) lowest and highest corners [m] of boxes that fill the voxels nobody has seen: within ``near`` of the
    path (N, 3), beyond ``free`` of the points ``around`` (M, 3)."""
    path, around = np.asarray(path, dtype=float).reshape(-1, 3), np.asarray(around, dtype=float).reshape(-1, 3)
    unknown = np.argwhere(space.unseen)
    centres = space.lower + (unknown + 0.5) * space.voxel
    counts = cKDTree(path).query(centres, distance_upper_bound=near)[0] <= near
    counts &= cKDTree(around).query(centres, distance_upper_bound=free)[0] > free
    chosen = np.zeros(space.labels.shape, bool)
    chosen[tuple(unknown[counts].T)] = True
    return space.boxes(chosen)


def on_the_arm(arm, joints, spacing: float = 0.02) -> np.ndarray:
    """(M, 3) points on the lines between the arm's link frames in a posture (J,) [rad], the base among them."""
    frames = arm.link_poses(np.atleast_2d(joints))[0]
    ends = [(frames[p][:3, 3], frames[i][:3, 3]) for i, p in enumerate(arm.tree.parent) if p >= 0]
    lines = [a + np.linspace(0, 1, int(np.linalg.norm(b - a) / spacing) + 2)[:, None] * (b - a) for a, b in ends]
    return np.concatenate(lines)
