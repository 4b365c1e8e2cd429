"""The way to where a taught motion begins: RRT-Connect (Kuffner & LaValle 2000) in joint space.

Two trees grow towards each other from both postures, an edge at a time, each edge certified clear by the sweep of
collision.py; then corners are cut. It is written out here, since every edge is certified, not sampled, and the same
seed must give the same way each time it is asked, while OMPL's random numbers are seeded once for a process.
"""

import numpy as np

from robot.inverse import NoSolution, branches, path_poses

EDGE, DENSE = 0.4, 0.05  # rad: length of an edge, and between the postures that are returned
EDGES, CUTS = 1500, 60  # tried at most
BESIDE = 5e-3  # m, beyond the margin, for corners that are rounded


class _Tree:
    def __init__(self, root):
        self.nodes, self.parents = [root], [-1]

    def nearest(self, q) -> int:
        return int(np.abs(np.array(self.nodes) - q).max(axis=1).argmin())

    def add(self, q, parent) -> int:
        self.nodes.append(q)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def way(self, node) -> list[np.ndarray]:
        """From the root to the node."""
        found = []
        while node >= 0:
            found.append(self.nodes[node])
            node = self.parents[node]
        return found[::-1]


def beginnings(model, start, point, margin: float, seed: int) -> list[np.ndarray]:
    """Postures (J,) whose hand is at the point (3,) and that keep ``margin`` [m], those nearest to ``start`` (J,) first; a robot
    with legs may stay where it stands. model: CollisionModel."""
    poses, rows = path_poses(np.reshape(point, (1, 3)))
    arms = [model.arm] if model.arm.legs is None else [model.arm.still(start), model.arm]
    found = [q for arm in arms for q in branches(arm, poses[0], rows, 0.0, seed)]
    clear = [q for q in found if model.clearance(q) >= margin]
    return sorted(clear, key=lambda q: np.abs(q - start).max())


def approach(model, start, end, margin: float, seed: int) -> np.ndarray:
    """Postures (T, J) from ``start`` to ``end`` (J,), at most DENSE apart, between which the arm keeps ``margin`` [m].

    model: CollisionModel. Raises NoSolution where no way is found.
    """
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    rng = np.random.default_rng(seed)
    for q, which in ((start, "start"), (end, "end")):
        clearance, pair = model.nearest(q)
        if clearance < margin:
            near = f"{pair[0]} is {1e3 * clearance:.1f} mm from {pair[1]} (margin {1e3 * margin:.0f} mm)"
            raise NoSolution(f"at the {which} of the approach {near}")
    corners = [start, end] if _clear(model, start, end, margin) else _connected(model, start, end, margin, rng)
    return _dense(_cut(model, corners, margin, rng))


def _clear(model, a, b, margin) -> bool:
    """Whether the straight motion keeps the margin; a coarse look first, since most edges that fail do so plainly."""
    if model.clearance(a + np.linspace(0, 1, 5)[1:, None] * (b - a)).min() < margin:
        return False
    return bool(model.sweep(np.stack([a, b]), required=margin, cap=0.1).clearance[0] >= margin - 1e-3)


def _connected(model, start, end, margin, rng) -> list[np.ndarray]:
    here, there, tried = _Tree(start), _Tree(end), 0
    lower, upper = np.maximum(model.arm.lower, -2 * np.pi), np.minimum(model.arm.upper, 2 * np.pi)
    while tried < EDGES:
        new = _extended(model, here, rng.uniform(lower, upper), margin)
        tried += 1
        while new is not None:
            met = _extended(model, there, here.nodes[new], margin)
            tried += 1
            if met is None:
                break
            if np.abs(there.nodes[met] - here.nodes[new]).max() < 1e-9:
                way = here.way(new) + there.way(met)[-2::-1]
                return way if np.array_equal(way[0], start) else way[::-1]
        here, there = there, here
    raise NoSolution(f"no way from where the arm is to where the motion begins was found in {EDGES} tries")


def _extended(model, tree, q, margin) -> int | None:
    """The node that one more edge towards q adds to the tree, None where that is not clear."""
    nearest = tree.nearest(q)
    step = q - tree.nodes[nearest]
    reached = tree.nodes[nearest] + step * min(1.0, EDGE / max(np.abs(step).max(), 1e-12))
    return tree.add(reached, nearest) if _clear(model, tree.nodes[nearest], reached, margin) else None


def _cut(model, corners, margin, rng) -> list[np.ndarray]:
    """Fewer corners: pairs of them are joined straight where that is clear."""
    for _ in range(CUTS):
        if len(corners) < 3:
            break
        i, j = sorted(rng.choice(len(corners), 2, replace=False))
        if j - i > 1 and _clear(model, corners[i], corners[j], margin):
            corners = corners[: i + 1] + corners[j:]
    return corners


def _dense(corners) -> np.ndarray:
    parts = [corners[0][None]]
    for a, b in zip(corners, corners[1:]):
        count = max(int(np.ceil(np.abs(b - a).max() / DENSE)), 1)
        parts.append(a + np.linspace(0, 1, count + 1)[1:, None] * (b - a))
    return np.vstack(parts)
