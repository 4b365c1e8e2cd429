"""What the arm must keep clear of when nobody has measured the world: the reconstruction's pieces, and what nobody has
seen.

    collision/*.obj     convex pieces of the mesh                                   (scene.surface)
    space               what of space is free, occupied, unseen                      (scene.surface.space.Space)

Unseen space counts as occupied within ``near`` of the taught path. Around the arm as it stands at the start it does
not: that it stands there shows that the place is free.

    with World.from_spec(reconstructed(folder, space, path, around)) as world: plan(skill, arm, world)
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

UNSEEN = "unseen"
"""What bodies of unseen space are called, with a number."""


def reconstructed(folder: str | Path, space, path, around, *, near: float = 0.25, free: float = 0.25) -> dict:
    """The data of a world (robot.worldfile) of the pieces in ``folder``/collision and of what is unseen near the path.

    space: scene.surface.space.Space or None, when nothing counts as unseen. path: (N, 3) points that the tip may pass; around:
    (M, 3) points on the arm at the start. near: how far from the path unseen space counts as occupied; free: how far
    around the arm it does not [m]. Raises FileNotFoundError where there is no piece. """
    pieces = sorted((Path(folder) / "collision").glob("*.obj"))
    if not pieces:
        where = Path(folder) / "collision"
        raise FileNotFoundError(f"no pieces in {where}: python -m scene.mesh makes them from a trained field")
    mesh = {"shape": "mesh", "position": [0.0, 0.0, 0.0]}
    objects = [mesh | {"name": file.stem, "file": str(file.absolute())} for file in pieces]
    boxes = unseen(space, path, around, near, free) if space is not None else []
    for i, (lower, upper) in enumerate(boxes):
        objects.append({
            "name": f"{UNSEEN}{i:03d}", "shape": "box", "size": (upper - lower).tolist(),
            "position": ((lower + upper) / 2).tolist(),
        })  # fmt: skip
    return {"name": "reconstruction", "objects": objects}


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
