"""Clearance of a posture and of a swept motion, to the world, to regions to keep out of, and to the arm itself.

Notation
    clearance   signed distance [m] between two convex pieces; negative: how deep they overlap; values above ``cap`` are
                given as ``cap``
    pair        (a, b): a piece of the arm and a piece of the world, or two pieces of the arm
    lower       a bound from below on a pair's clearance, from balls that cover the arm

Exact distances come from FCL, checked (separation.py), and asked only for pairs whose lower bound (bounds.py) is below
the smallest distance found so far.
Along a joint-space segment from q0 to q1 no point of a link strays farther than

    deviation = (sum |dq|)^2 R / 8        (R: a bound on the arm's length; the second derivative is at most 8 of this)

from the straight line between its two places, which are at most ``motion`` apart. Hence everywhere on the segment

    clearance >= (clearance(q0) + clearance(q1) - motion) / 2 - deviation

and segments are halved until this bound suffices or is sharper than the resolution. Nothing can be skipped.
"""

from copy import copy
from dataclasses import dataclass, replace

import fcl
import numpy as np

from robot import separation
from robot.bounds import lower_bounds
from robot.kinematics import PRISMATIC
from robot.separation import TRUSTED, Solid, gap
from robot.shapes import body_pieces, box, link_pieces, region_pieces, sphere

WORLD, ITSELF = 0, 1
NEAR_AT_HOME = 0.01  # m: what is nearer in a comfortable posture is a matter of coarse geometry
LANDED = 1.5e-3  # m before a surface, where a hand that is to touch it stops: it does not press blindly (Bullet takes 1 mm for a touch)
SLIDING = 1e-3  # m, by which a held thing may come nearer to what it rests on
ALWAYS_TOUCHING = 0.9  # share of random postures: such a pair is a matter of coarse geometry, not of the posture


@dataclass(frozen=True, eq=False)
class Sweep:
    """clearance (T-1,) [m]: bounds from below over each segment of a path. pairs: the names nearest in each."""

    clearance: np.ndarray
    pairs: tuple[tuple[str, str], ...]


class CollisionModel:
    """The arm among the bodies of a world, where they stand when this is made.

    arm: Arm. world: has ``client`` and ``bodies``, or None for the arm alone. regions: volumes in the world's frame
    that the arm may not enter (teach.hull.Region); they count as bodies of the world. only: {region or body: names of
    links}, those that bind these links alone. held: {body: posture (J,)} bodies of the world that the tip carries, grasped where
    they stand at that posture; what they rest on there (nearer than ``margin`` [m]) they may stay as near to, not nearer.
    landing: {body: names of links} that may come within LANDED of it, as if that were the margin. ignored: further pairs of names that may touch. cap: larger clearances are not told apart [m].

    Links that cannot move are not compared with the world (the base may stand on a table or in it). Of the arm's own
    pairs those are left out that are neighbours, (nearly) touch at home, or touch in nearly all random postures.
    """

    def __init__(self, arm, world=None, regions=(), ignored=(), cap=0.3, *, only=None, held=None, landing=None, margin=0.01):
        self.arm, self.cap = arm, float(cap)
        bodies = body_pieces(world.client, world.bodies) if world is not None else []
        self._only, self.held = _checked(only or {}, held or {}, arm, bodies, regions)
        carried = [_carried(arm, piece, self.held[piece.name]) for piece in bodies if piece.name in self.held]
        self.links, self.pieces = (tuple(column) for column in zip(*_arm_pieces(arm), *carried))
        self.surroundings = (*(piece for piece in bodies if piece.name not in self.held), *region_pieces(regions))
        rooms = [(room["link"], arm.legs.trunk) for room in arm.legs.room] if arm.legs else []
        self._ignored = {frozenset(pair) for pair in (*ignored, *rooms)}
        self._objects = [fcl.CollisionObject(piece.geometry) for piece in self.pieces]
        self._objects += [fcl.CollisionObject(p.geometry, _fcl_pose(p.frame_from_piece)) for p in self.surroundings]
        self._request = fcl.DistanceRequest(enable_nearest_points=True, enable_signed_distance=True)
        self.solids = [Solid(piece) for piece in self.pieces + self.surroundings]
        self._corners = np.stack([piece.corners() for piece in self.pieces])  # (P, 8, 3) in the links' frames
        self._link_of_piece = np.array(self.links)
        self._reach = _reach(arm, self._corners)
        self._cover()
        self._pairs = np.array(self._world_pairs(), dtype=np.int64).reshape(-1, 2)
        self._own = 0
        self._measured = None, None  # the last question and its answer: paths are measured, then swept
        self._choose_own_pairs()
        self._allowed = self._resting(margin) + self._landing(landing or {}, margin)  # (pairs,) [m], what is added to a pair's distance

    @property
    def names(self) -> tuple[str, ...]:
        """The links and bodies that pieces belong to."""
        return tuple(piece.name for piece in self.pieces + self.surroundings)

    @property
    def own_pairs(self) -> list[tuple[str, str]]:
        """The links that are compared with each other."""
        return [(self.names[a], self.names[b]) for a, b in self._pairs[len(self._pairs) - self._own :]]

    def clearance(self, q) -> np.ndarray:
        """q (J,) or (N, J) -> clearance () or (N,) [m], to the world and itself."""
        distance, _ = self.measure(q)
        smallest = distance.min(axis=1)
        return smallest[0] if np.ndim(q) == 1 else smallest

    def nearest(self, q) -> tuple[float, tuple[str, str]]:
        """q (J,) -> clearance [m] and the names that are nearest."""
        distance, pair = self.measure(q)
        which = int(distance[0].argmin())
        return float(distance[0, which]), self.pair_names(pair[0, which])

    def pair_names(self, pair) -> tuple[str, str]:
        return tuple(self.names[i] for i in self._pairs[pair]) if pair >= 0 else ("nothing", "nothing")

    def standing(self, world_from_moved, along=None) -> "CollisionModel":
        """The same arm, moved over the floor by world_from_moved (4, 4) with the body ``along``; its frames stay the arm's own, so
        that all else is moved the other way."""
        moved_from_world = np.linalg.inv(world_from_moved)
        there = lambda piece: piece if piece.name == along else replace(piece, frame_from_piece=moved_from_world @ piece.frame_from_piece)
        moved = copy(self)
        moved.surroundings = tuple(map(there, self.surroundings))
        moved._objects = self._objects[: len(self.pieces)]
        moved._objects += [fcl.CollisionObject(p.geometry, _fcl_pose(p.frame_from_piece)) for p in moved.surroundings]
        places = np.array([np.linalg.inv(p.frame_from_piece) for p in moved.surroundings]).reshape(-1, 4, 4)
        moved._bounds, moved._measured = (*self._bounds[:2], places), (None, None)
        return moved

    def beside(self, point, within) -> list[str]:
        """What stands around the arm within that distance [m] of a point (3,)."""
        pose = np.eye(4)
        pose[:3, 3] = point
        ball = Solid(sphere("", TRUSTED, pose)).arrays(pose)
        near = lambda k: separation.distance(ball, self._place(k + len(self.pieces), None)) <= within
        return sorted({piece.name for k, piece in enumerate(self.surroundings) if near(k)})

    def gaps(self, body) -> dict[str, float]:
        """{other body: how far it is from ``body`` [m], 0 or less where they meet} of what stands around the arm."""
        numbered = list(enumerate(self.surroundings, start=len(self.pieces)))
        ours, placed, gaps = [k for k, piece in numbered if piece.name == body], {}, {}
        for k, piece in numbered:
            if piece.name != body:
                gaps[piece.name] = min([self._distance(a, k, None, placed) for a in ours] + [gaps.get(piece.name, np.inf)])
        return gaps

    def measure(self, q, cap=None) -> tuple[np.ndarray, np.ndarray]:
        """q (N, J) -> clearance (N, 2) [m] to the world and to itself; nearest pairs (N, 2), -1 where beyond cap."""
        cap = self.cap if cap is None else min(cap, self.cap)
        asked = np.asarray(q, dtype=float).tobytes(), cap
        if asked != self._measured[0]:
            self._measured = asked, self._measure(self.arm.link_poses(q), cap)
        return self._measured[1]

    def _measure(self, poses, cap) -> tuple[np.ndarray, np.ndarray]:
        lower = self._lower(poses)
        distance, pair = np.full((len(poses), 2), cap), np.full((len(poses), 2), -1)
        split = len(self._pairs) - self._own
        for n in np.flatnonzero((lower < cap).any(axis=1)):
            placed = {}
            for group, (start, stop) in enumerate(((0, split), (split, len(self._pairs)))):
                distance[n, group], pair[n, group] = self._exact(poses[n], lower[n, start:stop], start, cap, placed)
        return distance, pair

    def close(self, q, within) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q (N, J) -> all pairs nearer than ``within`` [m]: rows of q (K,), pairs (K,), clearances (K,) [m], and the clearances'
        gradients by the joints (K, J)."""
        poses = self.arm.link_poses(q)
        rows, pairs = np.nonzero(self._lower(poses) < within)
        clearance, gradient = self._slopes(poses, rows, pairs)
        near = clearance < within
        return rows[near], pairs[near], clearance[near], gradient[near]

    def of_world(self, pairs) -> np.ndarray:
        """(K,) bool: which pairs (K,) are of the arm and the world."""
        return np.asarray(pairs) < len(self._pairs) - self._own

    def _slopes(self, poses, rows, pairs) -> tuple[np.ndarray, np.ndarray]:
        """Clearance (K,) [m] of one pair each, the links being at those ``rows`` (K,) of poses (N, L, 4, 4), in order, and its
        gradient by the joints (K, J).

        The nearest points of convex pieces lie on the pieces' common normal, wherever these move: so only what moves the points
        along it counts.
        """
        distance, points = np.zeros(len(pairs)), np.zeros((2, len(pairs), 3))
        for row in np.unique(rows):
            placed = {}
            for k in np.flatnonzero(rows == row):
                distance[k], found = self._between(*self._pairs[pairs[k]], poses[row], placed)
                points[:, k] = found.nearest_points
        poses = poses[rows]
        normal = (points[0] - points[1]) * np.sign(distance)[:, None]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        own, link, tree = ~self.of_world(pairs), self._link_of_piece, self.arm.tree
        gradient = tree.speeds(poses, link[self._pairs[pairs, 0]], points[0], normal)
        gradient[own] -= tree.speeds(poses[own], link[self._pairs[pairs[own], 1]], points[1, own], normal[own])
        return distance + self._allowed[pairs], gradient

    def _lower(self, poses) -> np.ndarray:
        bounds = lower_bounds(poses, self._balls, self._first, self._link_of_piece, self._pairs, *self._bounds)
        return bounds + self._allowed

    def _exact(self, poses, lower, start, cap, placed):
        """Smallest exact distance among the pairs from ``start``, and which. Overlapping pairs are all measured."""
        best, nearest = cap, -1
        for k in np.argsort(lower):
            if lower[k] >= max(best, 0.0) or lower[k] >= cap:
                break
            a, b = self._pairs[start + k]
            distance = self._distance(a, b, poses, placed) + self._allowed[start + k]
            if distance < best:
                best, nearest = distance, start + k
        return best, nearest

    def _distance(self, a, b, poses, placed) -> float:
        """Of two pieces, the links being at ``poses`` (L, 4, 4). placed: those that stand there already, {piece: solid}."""
        return self._between(a, b, poses, placed)[0]

    def _between(self, a, b, poses, placed) -> tuple[float, fcl.DistanceResult]:
        """The distance of two pieces, and FCL's answer with their nearest points."""
        for piece in (a, b):
            if piece not in placed:
                placed[piece] = self._place(piece, poses)
        found = fcl.DistanceResult()
        distance = fcl.distance(self._objects[a], self._objects[b], self._request, found)
        if distance <= 0:
            return distance, found
        (ax, ay, az), (bx, by, bz) = found.nearest_points
        certain = gap(*placed[a], *placed[b], ax - bx, ay - by, az - bz)
        return distance if certain > distance - TRUSTED else separation.distance(placed[a], placed[b]), found

    def _place(self, piece, poses) -> tuple:
        """The piece where it is, for separation.py; a piece of the arm is put there for FCL too."""
        if piece >= len(self.pieces):
            return self.solids[piece].arrays(self.surroundings[piece - len(self.pieces)].frame_from_piece)
        pose = poses[self._link_of_piece[piece]] @ self.pieces[piece].frame_from_piece
        self._objects[piece].setTransform(_fcl_pose(pose))
        return self.solids[piece].arrays(pose)

    def sweep(self, path, required=0.0, resolution=1e-3, cap=None) -> Sweep:
        """Clearance of the straight joint-space motions between the postures of ``path`` (T, J), bounded from below.

        Segments are halved until the bound is at least ``required`` [m] or within ``resolution`` [m] of the truth, or a
        posture on the segment falls short of ``required`` itself.
        """
        path = np.asarray(path, dtype=float)
        distance, pair = self.measure(path, cap)
        bound, seen, who = np.full(len(path) - 1, np.inf), np.full(len(path) - 1, np.inf), np.full(len(path) - 1, -1)
        owner = np.arange(len(path) - 1)
        for rows in (slice(None, -1), slice(1, None)):
            _keep_nearest(seen, who, owner, distance[rows], pair[rows])
        segments = (path[:-1], path[1:], distance[:-1], distance[1:], owner)
        while len(segments[0]):
            leaf, spread = self._segment_bound(*segments[:4])
            short = np.minimum(segments[2], segments[3]).min(axis=1) < required
            done = (leaf >= required) | short | (spread <= resolution)
            np.minimum.at(bound, segments[4][done], leaf[done])
            q0, q1, d0, d1, owner = (values[~done] for values in segments)
            middle = (q0 + q1) / 2
            distance, pair = self.measure(middle, cap)
            _keep_nearest(seen, who, owner, distance, pair)
            segments = tuple(
                np.concatenate(both)
                for both in ((q0, middle), (middle, q1), (d0, distance), (distance, d1), (owner, owner))
            )
        return Sweep(bound, tuple(self.pair_names(pair) for pair in who))

    def _segment_bound(self, q0, q1, d0, d1) -> tuple[np.ndarray, np.ndarray]:
        """Postures (S, J) and clearances (S, 2) at both ends -> bound from below (S,) [m] on the way, and how blunt it
        is (S,) [m]."""
        motion, deviation = self._motion(q0, q1)
        moving = np.array([1.0, 2.0])  # of two links of the arm both move
        between = (d0 + d1 - moving * motion[:, None]) / 2 - moving * deviation[:, None]
        return between.min(axis=1), motion + 2 * deviation

    def _motion(self, q0, q1) -> tuple[np.ndarray, np.ndarray]:
        """(S, J) twice -> how far any point of the arm is displaced (S,) [m], and how far it may stray from the line
        between (S,) [m]."""
        before, after = (self.arm.link_poses(q)[:, self._link_of_piece] for q in (q0, q1))
        shift = np.einsum("spij,pcj->spci", after[..., :3, :3] - before[..., :3, :3], self._corners)
        shift += (after[..., :3, 3] - before[..., :3, 3])[:, :, None]
        turn = np.abs(q1 - q0)
        bent = turn[:, self._turning].sum(axis=1)
        slid = turn[:, ~self._turning].sum(axis=1)
        return np.linalg.norm(shift, axis=-1).max(axis=(1, 2)), (bent**2 * self._reach + 2 * bent * slid) / 8

    # What is compared

    def _cover(self):
        covers = [piece.cover() for piece in self.pieces]
        self._balls = np.vstack(covers)
        self._first = np.cumsum([0, *map(len, covers)])
        bodies = self.surroundings
        self._bounds = (
            np.array([p.bound for p in bodies], dtype=np.int64),
            np.array([np.append(p.size, np.zeros(3 - len(p.size))) for p in bodies]).reshape(-1, 3),
            np.array([np.linalg.inv(p.frame_from_piece) for p in bodies]).reshape(-1, 4, 4),
        )
        columns = self.arm.tree.column
        slides = {c for c, kind in zip(columns, self.arm.tree.kind) if kind == PRISMATIC and c >= 0}
        self._turning = np.array([j not in slides for j in range(len(self.arm.joint_names))])

    def _world_pairs(self):
        rigid = self.arm.tree.rigid_groups
        moving = [a for a, link in enumerate(self.links) if rigid[link] != rigid[0]]
        names = self.names
        return [
            (a, b)
            for a in moving
            for b in range(len(self.pieces), len(names))
            if frozenset((names[a], names[b])) not in self._ignored
            and names[a] in self._only.get(names[b], names)
        ]

    def _resting(self, margin) -> np.ndarray:
        """How much nearer than ``margin`` held things are, where they are grasped, to what they rest on."""
        allowed = np.zeros(len(self._pairs))
        for name, posture in self.held.items():
            poses, placed = self.arm.link_poses(posture)[0], {}
            for k in np.flatnonzero([self.names[a] == name for a, _ in self._pairs[: len(self._pairs) - self._own]]):
                allowed[k] = max(0.0, margin + SLIDING - self._distance(*self._pairs[k], poses, placed))
        return np.where(allowed > SLIDING, allowed, 0.0)

    def _landing(self, landing, margin) -> np.ndarray:
        """How much nearer than ``margin`` links may come to what they land on."""
        names = self.names
        return np.array([max(margin - LANDED, 0.0) if names[a] in landing.get(names[b], ()) else 0.0 for a, b in self._pairs])

    def _choose_own_pairs(self):
        """Start from every pair of links that are not neighbours; drop those that (nearly) touch at home, or nearly always."""
        rigid = self.arm.tree.rigid_groups
        parents = {
            rigid[link]: rigid[self.arm.tree.parent[link]] for link in range(len(rigid)) if rigid[link] == link and link
        }
        count = len(self.pieces)
        groups = [rigid[link] for link in self.links]
        candidates = [
            (a, b)
            for a in range(count)
            for b in range(a + 1, count)
            if groups[a] != groups[b]
            and parents.get(groups[a]) != groups[b]
            and parents.get(groups[b]) != groups[a]
            and frozenset((self.names[a], self.names[b])) not in self._ignored
        ]
        postures = np.vstack([*self.held.values(), self.arm.home, self.arm.random(100, 0)])
        usual = len(self.held)  # where home stands
        clearance = np.zeros((len(postures), len(candidates)))
        for n, poses in enumerate(self.arm.link_poses(postures)):
            placed = {}
            clearance[n] = [self._distance(a, b, poses, placed) for a, b in candidates]
        held = np.array([bool({self.names[a], self.names[b]} & set(self.held)) for a, b in candidates])
        near = np.where(held, -np.inf, NEAR_AT_HOME)
        kept = (clearance[usual] > near) & ((clearance <= 0).mean(axis=0) < ALWAYS_TOUCHING)
        own = np.array([pair for pair, keep in zip(candidates, kept) if keep], dtype=np.int64).reshape(-1, 2)
        self._own = len(own)
        self._pairs = np.vstack([self._pairs, own])


def _arm_pieces(arm) -> list:
    """(index of the link, piece) of the arm; in place of legs, which step as the trunk goes, the room that holds them."""
    if arm.legs is None:
        return link_pieces(arm.description)
    bodies = [(index, piece) for index, piece in link_pieces(arm.description) if piece.name not in arm.legs.links]
    place = lambda room: np.block([[np.eye(3), np.array(room["position"], dtype=float)[:, None]], [np.zeros((1, 3)), 1.0]])
    rooms = [(arm.link_names.index(room["link"]), box(room["link"], room["size"], place(room))) for room in arm.legs.room]
    return bodies + rooms


def _checked(only, held, arm, bodies, regions):
    """``only`` and ``held`` as they are; ValueError where they name what is not there."""
    links, named = arm.link_names, {region.name for region in regions} | {piece.name for piece in bodies}
    for region, bound in only.items():
        unknown = [region] * (region not in named) or [link for link in bound if link not in links]
        if unknown:
            there = ", ".join([*sorted(named), *links])
            raise ValueError(f"a region that binds links names {unknown[0]!r}; there are {there}")
    for name, posture in held.items():
        if name not in {piece.name for piece in bodies}:
            there = ", ".join(sorted({piece.name for piece in bodies})) or "no bodies"
            raise ValueError(f"{name!r} cannot be held; there are {there}")
    return only, {name: np.array(posture, dtype=float) for name, posture in held.items()}


def _carried(arm, piece, posture) -> tuple:
    """(index of the tip's link, piece in that link's frame) of a piece of the world that is grasped at a posture."""
    tip = arm.link_names.index(arm.tip_link)
    pose = np.linalg.inv(arm.link_poses(posture)[0, tip]) @ piece.frame_from_piece
    return tip, replace(piece, frame_from_piece=pose)


def _keep_nearest(seen, who, owner, distance, pair):
    """Where distances (M, 2) of segments ``owner`` (M,) are smaller than those ``seen``, keep them and their pairs."""
    group = distance.argmin(axis=1)
    distance, pair = distance[np.arange(len(group)), group], pair[np.arange(len(group)), group]
    order = np.argsort(-distance, kind="stable")  # the last assignment wins
    order = order[distance[order] < seen[owner[order]]]
    seen[owner[order]], who[owner[order]] = distance[order], pair[order]


def _reach(arm, corners) -> float:
    """A bound [m] on the distance of any point from any joint: all offsets, all slides and the largest piece."""
    tree = arm.tree
    slides = [
        max(abs(arm.lower[c]), abs(arm.upper[c]))
        for c, kind in zip(tree.column, tree.kind)
        if kind == PRISMATIC and c >= 0
    ]
    offsets = np.linalg.norm(tree.origin[:, :3, 3], axis=1).sum() + np.abs(tree.held).sum()
    return float(offsets + sum(slides) + np.linalg.norm(corners, axis=-1).max())


def _fcl_pose(pose) -> fcl.Transform:
    return fcl.Transform(pose[:3, :3], pose[:3, 3])
