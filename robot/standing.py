"""Which things stand free, and on what: a world's file is judged before it is simulated.

Two fixed things may overlap (the published tables do). A movable one may overlap nothing, and rests on something: moved
down by REST it would enter that. A thing on a joint is held by its joint.
"""

import fcl
import numpy as np

from robot import thing as things
from robot.shapes import Piece, box, convex, cylinder, mesh_points

TOUCH = 5e-4  # m: what is shrunk by this on all sides overlaps nothing that it only touches
REST = 3e-3  # m: a gap below this is closed when the world comes to rest


def check(data: dict) -> None:
    """Raise ValueError for a movable thing inside another, or in the air. ``data``: a checked, varied world."""
    joints = data.get("joints", [])
    jointed = {joint["child"] for joint in joints}
    partners = {frozenset((joint["parent"], joint["child"])) for joint in joints}
    for thing in (one for one in data["objects"] if one.get("mass")):
        name, where = thing["name"], f"world {data['name']}, object {thing['name']}"
        others = [one for one in data["objects"] if one is not thing and frozenset((one["name"], name)) not in partners]
        inside = [other["name"] for other in others if not free(thing, [other])]
        if inside:
            raise ValueError(f"{where}: it can move and overlaps {', '.join(inside)}; move it out")
        if name not in jointed and not _overlap(thing_pieces(thing), others, [0, 0, -REST]):
            raise ValueError(f"{where}: it can move and rests on nothing; lower it onto something, or leave its mass away")


def free(thing: dict, others) -> bool:
    """Whether a thing overlaps none of the ``others`` (dicts as in the file), but for touching them."""
    return not _overlap(thing_pieces(thing, TOUCH), others, [0, 0, 0])


def _overlap(pieces, others, shift) -> bool:
    """Whether pieces, moved by ``shift`` [m], overlap things. FCL answers yes or no; its depths of boxes that just touch
    are not to be trusted."""
    ours = [fcl.CollisionObject(p.geometry, fcl.Transform(p.frame_from_piece[:3, :3], p.frame_from_piece[:3, 3] + shift)) for p in pieces]
    theirs = [fcl.CollisionObject(p.geometry, fcl.Transform(p.frame_from_piece[:3, :3], p.frame_from_piece[:3, 3]))
              for other in others for p in thing_pieces(other)]  # fmt: skip
    return any(fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()) for a in ours for b in theirs)


def thing_pieces(thing: dict, shrunk=0.0) -> list[Piece]:
    """The convex pieces of a thing of the file, where it says that it stands; primitives shrunk on all sides [m]."""
    name, pose = thing["name"], things.pose(thing)
    if thing["shape"] == "mesh":
        return [convex(name, mesh_points(thing["file"]), pose)]
    return [_piece(name, kind, np.array(size, dtype=float), pose @ own, shrunk) for kind, size, own in things.primitives(thing)]


def _piece(name, kind, size, pose, shrunk) -> Piece:
    if kind == "box":
        return box(name, np.maximum(size - 2 * shrunk, 1e-6), pose)
    return cylinder(name, *np.maximum(size - [shrunk, 2 * shrunk], 1e-6), pose)
