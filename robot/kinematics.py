"""Kinematics of a tree of links, compiled: forward kinematics, geometric Jacobian, damped least squares.

Notation
    l          a link; links are ordered, parents before children
    T_l        base_from_l = T_parent(l) origin_l motion_l(q)
    J          (6, J) geometric Jacobian of the tip: rows 0-2 velocity of its origin, rows 3-5 angular velocity, both in
               the base frame
    e          (6,) what is missing: position [m], and rotation vector [rad] times LEVER, so that both are lengths
    lambda     damping [m], chosen as Sugihara (2011): lambda^2 = DAMPING |e|^2 + FLOOR, hence quadratic convergence
               at the end
    rows       what of a target counts: POSITION, POINTED (and the direction of the z axis) or POSE
    slack      rotation [rad] by which the tip may be turned away; only what exceeds it is an error

Joints at a limit that the step pushes outwards are taken out of the step (active set), so limits hold at every
iteration.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

LEVER = 0.3  # m: a rotation error of 1 rad weighs as much as a position error of this length
DAMPING = 0.02
FLOOR, SETTLING_FLOOR = 1e-9, 1e-7  # m^2; the second keeps steps in the null space small near singular postures
FIXED, REVOLUTE, PRISMATIC = 0, 1, 2
POSITION, POINTED, POSE = 3, 5, 6


@dataclass(frozen=True, eq=False)
class Tree:
    """parent (L,) index of the parent link, -1 at the root; origin (L, 4, 4) parent_from_joint; axis (L, 3); kind (L,);
    column (L,) index into q, -1 for joints that are held; held (L,) their value [rad or m]."""

    parent: np.ndarray
    origin: np.ndarray
    axis: np.ndarray
    kind: np.ndarray
    column: np.ndarray
    held: np.ndarray

    def poses(self, q) -> np.ndarray:
        """(N, J) -> base_from_link (N, L, 4, 4)."""
        return batch_poses(
            self.parent, self.origin, self.axis, self.kind, self.column, self.held, np.ascontiguousarray(q)
        )

    def speeds(self, poses, links, points, along) -> np.ndarray:
        """How fast each joint moves a point (K, 3) of links (K,) along directions (K, 3), the links being at poses (K, L, 4, 4):
        (K, J), in m/rad and m/m."""
        out = np.zeros((len(points), self.column.max() + 1))
        for joint in np.flatnonzero(self.column >= 0):
            moves = self._below[joint, links]
            axis = poses[:, joint, :3, :3] @ self.axis[joint]
            turning = np.cross(axis, points - poses[:, joint, :3, 3])
            velocity = axis if self.kind[joint] == PRISMATIC else turning
            out[:, self.column[joint]] += moves * np.einsum("ki,ki->k", velocity, along)
        return out

    @cached_property
    def _below(self) -> np.ndarray:
        """(L, L) bool: whether the second link is the first or hangs from it."""
        below = np.eye(len(self.parent), dtype=bool)
        for link, parent in enumerate(self.parent):
            if parent >= 0:
                below[:, link] |= below[:, parent]
        return below

    @property
    def rigid_groups(self) -> np.ndarray:
        """(L,) for each link the first link it cannot move against."""
        groups = np.arange(len(self.parent))
        for link, parent in enumerate(self.parent):
            if parent >= 0 and self.column[link] < 0:
                groups[link] = groups[parent]
        return groups

    def extended(self, offset) -> "Tree":
        """The same with one more link, fixed to the last at ``offset`` (3,) in its frame [m]."""
        pose = np.eye(4)
        pose[:3, 3] = offset
        more = (len(self.parent) - 1, pose, np.zeros(3), FIXED, -1, 0.0)
        return Tree(*(np.concatenate([before, np.array([last], dtype=before.dtype)]) for before, last in zip(self.arrays, more)))

    @property
    def arrays(self) -> tuple:
        """The fields as the compiled functions take them."""
        return self.parent, self.origin, self.axis, self.kind, self.column, self.held


# The compiled functions spell out their loops: array expressions would take numba several times as long to compile.


@njit(cache=True)
def _poses(parent, origin, axis, kind, column, held, q, out):
    local, motion = np.empty((3, 4)), np.empty((3, 4))
    for link in range(len(parent)):
        value = q[column[link]] if column[link] >= 0 else held[link]
        _motion(kind[link], axis[link, 0], axis[link, 1], axis[link, 2], value, motion)
        _times(origin[link], motion, local)
        if parent[link] < 0:
            for i in range(3):
                for j in range(4):
                    out[link, i, j] = local[i, j]
        else:
            _times(out[parent[link]], local, out[link])
        out[link, 3, 0] = out[link, 3, 1] = out[link, 3, 2] = 0.0
        out[link, 3, 3] = 1.0


@njit(cache=True)
def _motion(kind, x, y, z, value, out):
    """Rotation about (Rodrigues) or translation along the axis (x, y, z), (3, 4)."""
    s, c, d = 0.0, 1.0, 0.0
    if kind == REVOLUTE:
        s, c = np.sin(value), np.cos(value)
    elif kind == PRISMATIC:
        d = value
    v = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = c + x * x * v, x * y * v - z * s, x * z * v + y * s, x * d
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = x * y * v + z * s, c + y * y * v, y * z * v - x * s, y * d
    out[2, 0], out[2, 1], out[2, 2], out[2, 3] = x * z * v - y * s, y * z * v + x * s, c + z * z * v, z * d


@njit(cache=True)
def _times(a, b, out):
    """Fill the upper three rows of the product of two rigid transforms."""
    for i in range(3):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
        out[i, 3] += a[i, 3]


@njit(cache=True)
def batch_poses(parent, origin, axis, kind, column, held, q):
    out = np.empty((len(q), len(parent), 4, 4))
    for n in range(len(q)):
        _poses(parent, origin, axis, kind, column, held, q[n], out[n])
    return out


@njit(cache=True)
def jacobian(tree, q, poses):
    """(6, J) at q (J,); fills ``poses`` (L, 4, 4). The tip is the last link and every link lies on its chain."""
    parent, origin, axis, kind, column, held = tree
    _poses(parent, origin, axis, kind, column, held, q, poses)
    J = np.zeros((6, len(q)))
    tip = len(parent) - 1
    for link in range(len(parent)):
        j = column[link]
        if j < 0:
            continue
        T, a = poses[link], axis[link]
        x = T[0, 0] * a[0] + T[0, 1] * a[1] + T[0, 2] * a[2]
        y = T[1, 0] * a[0] + T[1, 1] * a[1] + T[1, 2] * a[2]
        z = T[2, 0] * a[0] + T[2, 1] * a[1] + T[2, 2] * a[2]
        if kind[link] == PRISMATIC:
            J[0, j], J[1, j], J[2, j] = x, y, z
        else:
            u, v, w = poses[tip, 0, 3] - T[0, 3], poses[tip, 1, 3] - T[1, 3], poses[tip, 2, 3] - T[2, 3]
            J[0, j], J[1, j], J[2, j] = y * w - z * v, z * u - x * w, x * v - y * u
            J[3, j], J[4, j], J[5, j] = x, y, z
    return J


@njit(cache=True)
def rotation_vector(R):
    """Log of a rotation matrix (3, 3) as axis times angle (3,) [rad], by way of the largest quaternion component."""
    w = np.sqrt(max(0.0, 1.0 + R[0, 0] + R[1, 1] + R[2, 2])) / 2
    v = np.empty(3)
    if w > 0.1:
        v[0], v[1], v[2] = (R[2, 1] - R[1, 2]) / (4 * w), (R[0, 2] - R[2, 0]) / (4 * w), (R[1, 0] - R[0, 1]) / (4 * w)
    else:  # near half a turn the antisymmetric part vanishes
        i = 0
        for k in range(1, 3):
            if R[k, k] > R[i, i]:
                i = k
        j, k = (i + 1) % 3, (i + 2) % 3
        u = np.sqrt(max(0.0, 1.0 + R[i, i] - R[j, j] - R[k, k])) / 2
        w = (R[k, j] - R[j, k]) / (4 * u)
        sign = 1.0 if w >= 0 else -1.0
        w, v[i] = w * sign, u * sign
        v[j], v[k] = sign * (R[j, i] + R[i, j]) / (4 * u), sign * (R[k, i] + R[i, k]) / (4 * u)
    sine = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    factor = 2.0 if sine < 1e-12 else 2 * np.arctan2(sine, w) / sine
    for i in range(3):
        v[i] *= factor
    return v


@njit(cache=True)
def _pointing(target, pose, v):
    """Fill v (3,) with the shortest rotation vector [rad] that turns the pose's z axis to the target's."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        v[i] = pose[j, 2] * target[k, 2] - pose[k, 2] * target[j, 2]
    sine = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    cosine = pose[0, 2] * target[0, 2] + pose[1, 2] * target[1, 2] + pose[2, 2] * target[2, 2]
    if sine < 1e-9 and cosine < 0:  # opposite: half a turn about any axis across, such as the pose's x
        for i in range(3):
            v[i] = np.pi * pose[i, 0]
        return
    factor = np.arctan2(sine, cosine) / max(sine, 1e-12)
    for i in range(3):
        v[i] *= factor


@njit(cache=True)
def _error(target, pose, rows, slack, e, J):
    """Fill e (6,), or (3,) where orientation is free; return |e|^2, position error [m] and rotation error [rad].

    Directions that do not count are taken out of J (6, J): turning about z where rows is POINTED, all turning within
    the slack.
    """
    position2, rotation2 = 0.0, 0.0
    for i in range(3):
        e[i] = target[i, 3] - pose[i, 3]
        position2 += e[i] ** 2
    if rows != POSITION:
        v = np.empty(3)
        if rows == POINTED:
            _pointing(target, pose, v)
            for j in range(J.shape[1]):
                along = pose[0, 2] * J[3, j] + pose[1, 2] * J[4, j] + pose[2, 2] * J[5, j]
                for i in range(3):
                    J[3 + i, j] -= along * pose[i, 2]
        else:
            R = np.empty((3, 3))
            for i in range(3):
                for j in range(3):
                    R[i, j] = target[i, 0] * pose[j, 0] + target[i, 1] * pose[j, 1] + target[i, 2] * pose[j, 2]
            v = rotation_vector(R)
        angle = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        share = 1.0 if slack <= 0.0 else max(0.0, 1.0 - slack / max(angle, 1e-12))
        rotation2 = (share * angle) ** 2
        for i in range(3):
            e[3 + i] = share * v[i] * LEVER
            if share == 0.0:
                for j in range(J.shape[1]):
                    J[3 + i, j] = 0.0
    return position2 + LEVER**2 * rotation2, np.sqrt(position2), np.sqrt(rotation2)


@njit(cache=True)
def _solve_spd(A, b):
    """x of A x = b, A symmetric positive definite (n, n), by Cholesky; A and b are overwritten."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i == j:
                A[i, i] = np.sqrt(max(s, 1e-18))
            else:
                A[i, j] = s / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]
    return b


@njit(cache=True)
def _damped_step(J, e, pull, free, damping2, dq):
    """Fill dq = J^T (J J^T + lambda^2 I)^-1 (e - J pull) + pull over the free joints. J: its first len(e) rows count,
    the angular ones times LEVER."""
    rows, joints = len(e), J.shape[1]
    A, b = np.zeros((rows, rows)), np.empty(rows)
    for i in range(rows):
        b[i] = e[i]
        for j in range(joints):
            if free[j]:
                b[i] -= (J[i, j] if i < 3 else LEVER * J[i, j]) * pull[j]
                for k in range(i + 1):
                    A[i, k] += (J[i, j] if i < 3 else LEVER * J[i, j]) * (J[k, j] if k < 3 else LEVER * J[k, j])
        A[i, i] += damping2
    _solve_spd(A, b)
    for j in range(joints):
        dq[j] = 0.0
        if free[j]:
            dq[j] = pull[j]
            for i in range(rows):
                dq[j] += (J[i, j] if i < 3 else LEVER * J[i, j]) * b[i]


@njit(cache=True)
def _step(J, e, pull, q, lower, upper, damping2, dq):
    """Fill dq = J^# e + (I - J^# J) pull, with joints that would leave their limits held (active set).

    Returns max |dq|."""
    free = np.ones(len(q), np.bool_)
    again = True
    while again:
        _damped_step(J, e, pull, free, damping2, dq)
        again = False
        for j in range(len(q)):
            if free[j] and ((q[j] >= upper[j] and dq[j] > 0) or (q[j] <= lower[j] and dq[j] < 0)):
                free[j] = False
                again = True
    largest = 0.0
    for j in range(len(q)):
        largest = max(largest, abs(dq[j]))
    return largest


@njit(cache=True)
def _advance(q, dq, longest, limit, lower, upper):
    """q + dq in place, scaled so that no joint moves by more than ``limit``, within the limits."""
    scale = min(1.0, limit / max(longest, 1e-12))
    for j in range(len(q)):
        q[j] = min(max(q[j] + scale * dq[j], lower[j]), upper[j])


@njit(cache=True)
def _copy(values, out):
    for j in range(len(values)):
        out[j] = values[j]


@njit(cache=True)
def _residual(rows):
    return np.empty(3 if rows == POSITION else 6)


@njit(cache=True)
def reach(tree, lower, upper, target, q, rows, slack, iterations, tolerance, largest):
    """Levenberg-Marquardt from q, in place. largest: longest step of a joint [rad].

    Leaves the best posture in q; returns its position error [m] and rotation error [rad]. Ends early where progress
    stalls.
    """
    poses, e, dq, nothing = np.empty((len(tree[0]), 4, 4)), _residual(rows), np.zeros(len(q)), np.zeros(len(q))
    _advance(q, dq, 0.0, 1.0, lower, upper)
    best_q, best, best_position, best_rotation, stalled = np.empty(len(q)), np.inf, np.inf, np.inf, 0
    for _ in range(iterations):
        J = jacobian(tree, q, poses)
        size2, position, rotation = _error(target, poses[len(poses) - 1], rows, slack, e, J)
        stalled = 0 if size2 < 0.98 * best else stalled + 1
        if size2 < best:
            best, best_position, best_rotation = size2, position, rotation
            _copy(q, best_q)
        if size2 < tolerance**2 or stalled > 8:
            break
        longest = _step(J, e, nothing, q, lower, upper, size2 * DAMPING + FLOOR, dq)
        _advance(q, dq, longest, largest, lower, upper)
    _copy(best_q, q)
    return best_position, best_rotation


@njit(cache=True)
def settle(tree, lower, upper, target, q, rest, gain, rows, slack, iterations, tolerance):
    """The posture nearest to ``rest`` among those that keep the target: min |q - rest| subject to e(q) = 0, in place,
    from q close to it.

    Each step closes ``gain`` of the gap to rest in the null space; the last ones only restore the target. Returns the
    position error [m] and rotation error [rad].
    """
    poses, e, dq, pull = np.empty((len(tree[0]), 4, 4)), _residual(rows), np.zeros(len(q)), np.zeros(len(q))
    position, rotation = np.inf, np.inf
    for i in range(iterations + 6):
        J = jacobian(tree, q, poses)
        size2, position, rotation = _error(target, poses[len(poses) - 1], rows, slack, e, J)
        for j in range(len(q)):
            pull[j] = gain * (rest[j] - q[j]) if i < iterations else 0.0
        longest = _step(J, e, pull, q, lower, upper, size2 * DAMPING + SETTLING_FLOOR, dq)
        if size2 < tolerance**2 and (i >= iterations or longest < 1e-4):
            break
        _advance(q, dq, longest, 0.2, lower, upper)
    return position, rotation


@njit(cache=True)
def solve(tree, lower, upper, target, starts, rows, slack, iterations, position_tolerance, rotation_tolerance):
    """Try starts (S, J) in turn until one reaches the target, else the best. Returns q, position and rotation error."""
    q, best_q = np.empty(starts.shape[1]), np.empty(starts.shape[1])
    best_position, best_rotation = np.inf, np.inf
    for s in range(len(starts)):
        _copy(starts[s], q)
        position, rotation = reach(tree, lower, upper, target, q, rows, slack, iterations, 1e-6, 0.8)
        if position + LEVER * rotation < best_position + LEVER * best_rotation:
            best_position, best_rotation = position, rotation
            _copy(q, best_q)
        if position < position_tolerance and rotation < rotation_tolerance:
            break
    return best_q, best_position, best_rotation


@njit(cache=True)
def track(tree, lower, upper, targets, rests, q, gain, rows, slack, tolerance):
    """Follow targets (T, 4, 4) from q (changed), staying near rests (T, J) in the null space.

    Returns q (T, J), position errors (T,) [m], rotation errors (T,) [rad].
    """
    count = len(targets)
    path, position, rotation = np.empty((count, len(q))), np.empty(count), np.empty(count)
    for t in range(count):
        position[t], rotation[t] = settle(tree, lower, upper, targets[t], q, rests[t], gain, rows, slack, 8, tolerance)
        if position[t] + LEVER * rotation[t] > 10 * tolerance:
            _copy(q, path[t])
            p, r = reach(tree, lower, upper, targets[t], path[t], rows, slack, 60, tolerance, 0.2)
            if p + LEVER * r < position[t] + LEVER * rotation[t]:
                position[t], rotation[t] = p, r
                _copy(path[t], q)
        _copy(q, path[t])
    return path, position, rotation
