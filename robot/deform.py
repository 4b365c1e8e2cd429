"""The most likely motion that keeps clear: the mean of a distribution, moved away from obstacles as little as it says.

Notation
    w = m + R z     weights; R R^T = S, so that |z|^2 is the squared Mahalanobis distance from the mean
    x(t)            the tip's path, Psi(t)^T w;  q(t): the postures that follow it with one profile (postures.py)
    c(q)            clearance [m] of a pair of pieces (collision.py), for all pairs that are near
    g               its gradient by the tip's place, dc/dx = dc/dq J^#, in which the other joints follow

    minimise |z|^2 + sum cost s^2   subject to   c(q(t)) + g(t) . (x(t) - x_now(t)) + s >= wanted,  s >= 0

for all waypoints t and pairs, once for the margin (MUST) and once for what is comfortable (MAY); linearised again after
each step (sequential quadratic programming), a least distance problem each time (Lawson & Hanson 1974, ch. 23). Where
that gets stuck, it begins again from four motions that go by on either side, above and below. A waypoint out of reach
pushes like a wall. The start is where S says (conditioned: it has no freedom), the end is kept by conditioning on it; before, an
end out of reach is moved to the nearest place within it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from robot.attempt import Attempt, Search, title
from robot.inverse import NoSolution, directions
from robot.postures import path_to

ROUNDS, PATIENCE, LONGEST = 12, 3, 0.06  # steps, those without gain, and how far one may move the path [m]
MUST, MAY = 1e8, 1e4  # 1/m^2: 1 mm less than the margin costs as much as 10 deviations, 1 cm less than is comfortable 1
STRIDE = 3  # every third waypoint is watched; the result is checked at all and between them
BUFFER = 3e-3  # m, beyond the margin, for what happens between waypoints
ASIDE = 0.1  # m, how far aside other beginnings are
INSIDE, LIKELY = 5e-3, 2.0  # m, from the rim of the reach; deviations, by which an end out of reach is moved at most
LITTLE, SETTLED = 1e-3, 2e-3  # m: less clearance than that is no gain; a step that moves the path by less is the last


@dataclass(frozen=True, eq=False)
class Moved:
    """attempt: the best that was found, feasible or not. distance [m]: the farthest that a waypoint was moved.
    deviations: |z|."""

    attempt: Attempt
    distance: float
    deviations: float


def within_reach(search, way, farthest) -> tuple:
    """A Route (conditioned on the start), and no words; where its end is out of the arm's reach, the same to the nearest place within it and
    what is said of that, if it is no farther than ``farthest`` [m] and the distribution has it so near."""
    end, spread = way.distribution.mean_at([1.0])[0], way.distribution.covariance_at([1.0])[0]
    if search.lands or search.arm.legs or not np.isfinite(end).all():
        return way, ""
    pose = np.eye(4)
    pose[:3, 3] = end
    try:
        search.arm.ik(pose, start=search.start, position_only=True)
        return way, ""
    except NoSolution as error:
        short = search.arm.fk(error.posture)[:3, 3] - end
    short *= 1 + INSIDE / np.linalg.norm(short)
    far, deviations = np.linalg.norm(short), np.sqrt(short @ np.linalg.inv(spread + 1e-6 * np.eye(3)) @ short)
    if far > farthest or deviations > LIKELY:
        return way, ""
    said = f"it ends {1e3 * far:.0f} mm ({deviations:.1f} deviations) before the taught end, which is out of reach"
    return replace(way, distribution=way.distribution.condition(1.0, end + short)), said


def moved_mean(search: Search, distribution, first: Attempt, index: int, farthest: float) -> Moved | None:
    """The mean of a TrajectoryDistribution (conditioned on the start), moved until it keeps the search's margin.

    first: the mean's own attempt, whose profile is kept. index: of the new attempt. farthest [m]: a waypoint is moved no
    farther. None where no posture reaches the end.
    """
    if first.profile is None:
        return None
    t = np.linspace(0, 1, len(first.points))
    kept = distribution.condition(1.0, distribution.mean_at([1.0])[0])
    mean, R = kept.mean_at(t), kept.features(t) @ _root(kept.covariance)
    found = _descend(search, mean, R, np.zeros(R.shape[1]), first.profile, index, farthest)
    if not found.attempt.refusal:
        return found
    around = _around(search, mean, R, first.profile)
    others = [_descend(search, mean, R, z, first.profile, index, farthest) for z in around]
    return min([found, *others], key=lambda moved: (bool(moved.attempt.refusal), moved.deviations))


def _around(search, mean, R, profile) -> list[np.ndarray]:
    """Where else to begin: what meets something worst goes by above, below, left and right of where it is."""
    near = _near(search, mean, profile)
    worst = int(near.rows[near.clearance.argmin()]) if len(near.rows) else len(mean) // 2
    along = directions(np.gradient(mean, axis=0))[worst]
    left = np.cross([0.0, 0.0, 1.0], along) + 1e-3 * np.array([0.0, 1.0, 0.0])
    left /= np.linalg.norm(left)
    here = np.linalg.pinv(R[3 * worst : 3 * worst + 3], rcond=1e-3)
    return [here @ (ASIDE * side) for side in (np.cross(along, left), left, -left, np.cross(left, along))]


def _descend(search, mean, R, z, profile, index, farthest) -> Moved:
    """The feasible motion nearest to the mean that is found from z on; where there is none, the last."""
    best, clearest, stalled, buffer = None, -np.inf, 0, BUFFER
    moved = lambda z: (R @ z).reshape(-1, 3)
    for round in range(ROUNDS + 1):
        near = _near(search, mean + moved(z), profile)
        far = float(np.linalg.norm(moved(z), axis=1).max())
        clear = near.clearance.min(initial=np.inf)
        gains = clear > clearest + LITTLE and far <= farthest  # to come clear by going too far is none
        stalled, clearest = (0, clear) if gains else (stalled + 1, clearest)
        last = round == ROUNDS or stalled == PATIENCE and best is None
        if last and best is None or far <= farthest and clear >= search.margin:
            attempt, _ = search.best(index, mean + moved(z), [profile], np.inf)
            best = Moved(attempt, far, float(np.linalg.norm(z))) if best is None or not attempt.refusal else best
            buffer += BUFFER * bool(attempt.refusal)  # it came too close between the waypoints that are watched
        step = _nearer(near, R, z, search, buffer) - z
        longest = np.linalg.norm(moved(step), axis=1).max()
        if last or longest < SETTLED and best is not None and not best.attempt.refusal:
            break
        z = z + step * min(1.0, LONGEST / max(longest, 1e-9))
    too_far = f"{title(index)}: it would have to move by more than {1e3 * farthest:.0f} mm"
    return best if best.distance <= farthest else replace(best, attempt=replace(best.attempt, refusal=too_far))


@dataclass(frozen=True, eq=False)
class _Near:
    """What is near along a path: at waypoint rows (K,), clearance (K,) [m], its gradient (K, 3), whether to the world."""

    rows: np.ndarray
    clearance: np.ndarray
    gradient: np.ndarray
    world: np.ndarray

def _nearer(near, R, z, search, buffer) -> np.ndarray:
    """The z that solves the problem as it is linear around the present one."""
    A = np.einsum("ka,kan->kn", near.gradient, R.reshape(-1, 3, len(z))[near.rows])
    missing = A @ z - near.clearance
    must = near.clearance < search.margin + buffer + LONGEST / 2
    b = np.concatenate([(missing + search.margin + buffer)[must], (missing + search.comfortable)[near.world]])
    cost = np.repeat([MUST, MAY], [must.sum(), near.world.sum()])
    return least(np.vstack([A[must], A[near.world]]), b, cost)


def _near(search, points, profile) -> _Near:
    path, wall = _followed(search, points, profile)
    watched = np.arange(0, len(path), STRIDE)
    rows, pairs, clearance, by_joints = search.model.close(path[watched], search.comfortable + LONGEST / 2)
    rows = watched[rows]
    size = 3 if profile.turned is None else 6
    J = np.array([search.arm.jacobian(q)[:size] for q in path]).reshape(len(path), size, len(search.start))
    follows = np.linalg.pinv(J, rcond=1e-2)[..., :3]  # (N, J, 3): the joints' answer to the tip's displacement
    gradient, world = np.einsum("kj,kji->ki", by_joints, follows[rows]), search.model.of_world(pairs)
    if wall is None:
        return _Near(rows, clearance, gradient, world)
    depth = np.linalg.norm(wall)
    rows, clearance, world = np.append(rows, len(path)), np.append(clearance, -depth), np.append(world, False)
    return _Near(rows, clearance, np.vstack([gradient, wall / depth]), world)


def _followed(search, points, profile):
    """The postures as far as the path can be followed, and what is missing (3,) [m] from the first waypoint that is out of
    reach to the nearest place within it."""
    try:
        return path_to(search.arm, points, search.start, profile), None
    except NoSolution as error:
        if error.posture is None:
            return np.reshape(error.path, (-1, len(search.start))), None
        wall = search.arm.fk(error.posture)[:3, 3] - points[error.waypoint]
        return np.reshape(error.path, (-1, len(search.start))), wall if np.linalg.norm(wall) > LITTLE else None


def least(A, b, cost=MUST) -> np.ndarray:
    """z of least |z|^2 + sum cost s^2 with A z + s >= b: by its dual, a non-negative least squares problem."""
    if not len(b):
        return np.zeros(A.shape[1])
    E = np.vstack([A.T, np.diag(1 / np.sqrt(np.broadcast_to(cost, b.shape))), b])
    u, _ = nnls(E, np.append(np.zeros(len(E) - 1), 1.0), maxiter=20 * len(b) + 100)
    r = E @ u
    r[-1] -= 1.0
    return -r[: A.shape[1]] / r[-1] if abs(r[-1]) > 1e-12 else np.zeros(A.shape[1])


def _root(S) -> np.ndarray:
    """R with R R^T = S, which may be singular."""
    values, vectors = np.linalg.eigh(S)
    return vectors * np.sqrt(np.maximum(values, 0.0))
