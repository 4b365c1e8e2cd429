"""plan: a distribution of trajectories becomes one checked and timed motion.

    1. Condition the distribution on where the hand is. The candidates are its mean and samples of it; where the skill
       knows several ways, the mean of each and samples of each by its share.
    2. For each, find a joint path that keeps the tip on it (postures.py: which way the hand is turned is free unless
       taught) and measure its clearance to the world and to the arm itself, swept between waypoints (collision.py).
       All profiles are tried on the mean; the samples begin with those that served the mean best (attempt.py).
       A mean that is refused is moved away from what it meets, as little as its distribution says (deform.py).
    3. Of the feasible candidates take the most likely that is ``comfortable`` clear; if none is, the one with most
       clearance.
    4. Time it (timing.py) and check the timed motion once more, as it will be performed.

Likelihood is compared by the squared Mahalanobis distance to the conditioned mean, averaged over the path.
"""

from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull

from robot.attempt import RESOLUTION, Attempt, Search, swept_refusal, title
from robot.collision import ITSELF, WORLD, CollisionModel
from robot.deform import Moved, moved_mean
from robot.timing import motion_spline, time_path
from scene.files import replacing
from teach.hull import Region, visual_hull

MOVED = -1  # the index of the first way's moved mean; that of the second is one below
POSITION_TOLERANCE = 2e-3  # m, of the timed motion against the candidate


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion and what was checked about it; at rest at both ends, the first row is the present state.

    times (T,) [s]. joints (T, J) [rad]. names: of the joints. position_error (T,) [m]: tip against the candidate
    followed. clearance (T,) [m]: to the world and the skill's keep-out regions, at most 0.3. self_clearance (T,) [m]: of the arm to itself. tip (T, 3)
    [m]. refusals: a sentence for each refused candidate. samples: candidates tried. chosen: which is followed, 0 is the
    mean. way: of the skill's ways the one that is followed, the most usual is 0. feasible: whether the motion passed every check; where False, ``joints`` are the least bad candidate, not to
    be performed.
    """

    times: np.ndarray
    joints: np.ndarray
    names: tuple[str, ...]
    position_error: np.ndarray
    clearance: np.ndarray
    self_clearance: np.ndarray
    tip: np.ndarray
    refusals: tuple[str, ...]
    samples: int
    chosen: int
    feasible: bool
    way: int = 0
    moved: str = ""

    @property
    def sentence(self) -> str:
        """What came of it, in one line."""
        if not self.feasible:
            return f"none of {self.samples} candidates is feasible; {self.refusals[self.chosen]}" + f"; {self.moved}" * bool(self.moved)
        which = (title(self.chosen) if self.chosen >= 0 else self.moved) + f" (way {self.way + 1})" * (self.way > 0)
        feasible, clear, error = (
            self.samples - len(self.refusals),
            1e3 * self.clearance.min(),
            1e3 * self.position_error.max(),
        )
        return (
            f"{which} is taken, {feasible} of {self.samples} candidates are feasible: {self.times[-1]:.1f} s, "
            f"at least {clear:.0f} mm clear of the world, position within {error:.2f} mm"
        )

    def joint_trajectory(self) -> dict:
        """In the layout of ROS 2's trajectory_msgs/JointTrajectory; the first point is the present state."""
        motion = motion_spline(self.times, self.joints)
        rows = zip(self.times, self.joints, motion(self.times, 1), motion(self.times, 2))
        points = [
            {
                "positions": q.tolist(),
                "velocities": v.tolist(),
                "accelerations": a.tolist(),
                "effort": [],
                "time_from_start": dict(zip(("sec", "nanosec"), divmod(round(1e9 * t), 10**9))),
            }
            for t, q, v, a in rows
        ]
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        return {"header": header, "joint_names": list(self.names), "points": points}

    def save(self, path) -> None:
        """Write an npz file, whole or not at all."""
        words = ("names", "refusals", "moved")
        values = {f.name: np.array(getattr(self, f.name), dtype=str if f.name in words else None) for f in fields(self)}
        with replacing(path) as temporary:
            np.savez(temporary, **values)

    @classmethod
    def load(cls, path) -> "Plan":
        """Read what ``save`` wrote. Raises FileNotFoundError, or ValueError for any other file."""
        if not Path(path).is_file():
            raise FileNotFoundError(f"no plan file {path}")
        try:
            with np.load(path, allow_pickle=False) as file:
                later = {"way": np.array(0), "moved": np.array("")}  # earlier files have none
                values = {f.name: file[f.name] if f.name in file else later[f.name] for f in fields(cls)}
        except (ValueError, KeyError, EOFError, OSError, BadZipFile) as error:
            raise ValueError(f"{path} is not a plan file ({error}); robot.plan writes one") from None
        words = {name: tuple(values[name].tolist()) for name in ("names", "refusals")}
        numbers = {name: values[name].item() for name in ("samples", "chosen", "feasible", "way", "moved")}
        return cls(**values | words | numbers)


def plan(
    skill,
    arm,
    world,
    *,
    start=None,
    seed=0,
    samples=20,
    waypoints=100,
    margin=0.01,
    comfortable=0.03,
    postures=12,
    rate=50.0,
    moved=0.2,
    keep_out=(),
    outlined_for=None,
    held=(),
) -> Plan:
    """Choose, check and time a motion of the arm among the bodies of the world.

    skill: Skill. arm: Arm. world: World (or anything with ``client`` and ``bodies``), None for free space. start (J,)
    [rad]: the present posture (home). seed: of the samples. samples: candidates, the mean among them. waypoints: of
    each path. moved [m]: how far a mean that is refused may be moved at most, 0 for not at all. margin [m]: least clearance to anything. comfortable [m]: clearance beyond which more likely is better
    than more clear. postures: end postures tried on the mean. rate [Hz]: samples of the plan.
    keep_out: boxes in the world's frame to keep out of, mappings {name, lower (3,), upper (3,) [m], links}; links: the
    only ones that must keep out of it, all where it is absent. outlined_for: the only links that must keep out of the
    regions that skill.keep_out outlines, all where it is None. held: bodies that the hand carries from the start.
    Regions are kept clear of as if they were bodies. The motion takes at least
    ``skill.duration``. Raises ValueError where the start itself is out of limits or too close to something, SketchError
    where outlines bound no region.
    """
    if samples < 1 or waypoints < 2:
        raise ValueError(f"a plan needs at least 1 sample and 2 waypoints, not {samples} and {waypoints}")
    start = np.array(arm.home if start is None else start, dtype=float)
    drawn, boxes = visual_hull(skill.keep_out), [_box(volume) for volume in keep_out]
    only = {region.name: outlined_for for region in drawn if outlined_for is not None}
    only |= {volume["name"]: volume["links"] for volume in keep_out if volume.get("links") is not None}
    model = CollisionModel(arm, world, [*drawn, *boxes], only=only, held={name: start for name in held}, margin=margin)
    _check_start(arm, model, start, margin)
    ways = skill.starting_at(arm.fk(start)[:3, 3])[:samples]
    candidates, way = _candidates(ways, samples, waypoints, seed)
    search = Search(arm, model, start, margin, comfortable, postures)
    attempts = search.all(candidates, skill.orientation)
    detours = _detours(search, ways, attempts, moved)
    said = "; ".join(_said(detour, index) for index, detour in detours.items())
    attempts += [detour.attempt for detour in detours.values() if detour]
    way = dict(enumerate(way)) | {index: MOVED - index for index in detours}
    unlikely = {a.index: _unlikely(ways[way[a.index]], a.points) for a in attempts}
    refusals = {a.index: a.refusal for a in attempts if a.refusal}
    for attempt in _in_order(attempts, unlikely, comfortable):
        try:
            timed = _time(arm, model, attempt, skill.duration, rate)
            refusals[attempt.index] = _timed_refusal(model, timed, attempt.index, margin)
        except ValueError as error:
            refusals[attempt.index] = f"{title(attempt.index)}: {error}"
        if not refusals[attempt.index]:
            del refusals[attempt.index]
            return _plan(arm, timed, refusals, attempt.index, samples, int(way[attempt.index]), said, True)
    least_bad = max((a for a in attempts if a.index >= 0), key=lambda a: a.rank)
    timed = _untimely(arm, model, least_bad, skill.duration, rate)
    return _plan(arm, timed, refusals, least_bad.index, samples, int(way[least_bad.index]), said, False)


def _box(volume) -> Region:
    """A Region from its mapping. Raises ValueError where that is not one."""
    unknown = set(volume) - {"name", "lower", "upper", "links"}
    if unknown or not {"name", "lower", "upper"} <= set(volume):
        raise ValueError(f"a box to keep out of has a name, lower, upper and perhaps links, not {', '.join(volume)}")
    lower, upper = (np.array(volume[key], dtype=float) for key in ("lower", "upper"))
    if lower.shape != (3,) or upper.shape != (3,) or not (lower < upper).all():
        raise ValueError(f"the box {volume['name']} must have lower below upper, three numbers each [m]")
    corners = np.where(np.array(list(product((False, True), repeat=3))), upper, lower)
    return Region(volume["name"], ((corners, ConvexHull(corners).simplices),))


def _check_start(arm, model, start, margin):
    if start.shape != arm.home.shape or not np.isfinite(start).all():
        raise ValueError(f"the start must be {len(arm.home)} finite joint values, not {start}")
    if not arm.within_limits(start)[0]:
        over = [
            name for name, q, a, b in zip(arm.joint_names, start, arm.lower, arm.upper) if not a - 1e-6 <= q <= b + 1e-6
        ]
        raise ValueError(f"the start is outside the joint limits of {', '.join(over)}; start the arm elsewhere")
    clearance, (a, b) = model.nearest(start)
    if clearance < margin:
        where = f"{-1e3 * clearance:.0f} mm inside" if clearance < 0 else f"only {1e3 * clearance:.1f} mm from"
        raise ValueError(f"at the start {a} is {where} {b} (margin {1e3 * margin:.0f} mm); start the arm elsewhere")


def _candidates(ways, samples, waypoints, seed):
    """Paths (samples, N, 3), the means of the ways first, and whose way each goes (samples,)."""
    t, rng = np.linspace(0, 1, waypoints), np.random.default_rng(seed)
    counts = np.diff(np.round((samples - len(ways)) * np.cumsum([0.0] + [way.share for way in ways])).astype(int))
    paths = [
        np.concatenate([way.distribution.mean_at(t)[None], way.distribution.sample(count, t, rng)])
        for way, count in zip(ways, counts, strict=True)
    ]
    if not all(np.isfinite(part).all() for part in paths):
        raise ValueError("the skill's distribution gives trajectories that are not finite numbers; fit it again")
    of_way = [np.full(len(part), k) for k, part in enumerate(paths)]
    means_first = lambda parts: np.concatenate([part[:1] for part in parts] + [part[1:] for part in parts])
    return means_first(paths), means_first(of_way)


def _unlikely(way, points) -> float:
    """Squared Mahalanobis distance of points (N, 3) to the mean of a way, on average, and twice the negative log share."""
    t = np.linspace(0, 1, len(points))
    away = points - way.distribution.mean_at(t)
    inverse = np.linalg.inv(way.distribution.covariance_at(t) + 1e-6 * np.eye(3))  # it vanishes at the start
    return np.einsum("ta,tab,tb->", away, inverse, away) / len(points) - 2 * np.log(way.share)


def _detours(search, ways, attempts, farthest) -> dict[int, Moved | None]:
    """{index: the moved mean} of each way whose mean is refused."""
    refused = [k for k in range(len(ways)) if attempts[k].refusal] if farthest > 0 else []
    return {
        MOVED - k: moved_mean(search, ways[k].distribution, attempts[k], MOVED - k, farthest)
        for k in refused
    }


def _said(detour, index) -> str:
    if detour is None:
        return f"{title(index)}: no posture of the arm reaches the end"
    if detour.attempt.refusal:
        return detour.attempt.refusal
    return f"the mean moved by at most {1e3 * detour.distance:.0f} mm ({detour.deviations:.1f} deviations)"


def _in_order(attempts, unlikely, comfortable) -> list[Attempt]:
    """The feasible ones: those comfortably clear, most likely first; then the others, most clear first."""
    feasible = [a for a in attempts if not a.refusal]
    clear = sorted((a for a in feasible if a.clearance >= comfortable), key=lambda a: unlikely[a.index])
    return clear + sorted((a for a in feasible if a.clearance < comfortable), key=lambda a: -a.clearance)


@dataclass(frozen=True, eq=False)
class _Timed:
    times: np.ndarray
    joints: np.ndarray
    waypoint: np.ndarray  # (T,) fraction of the path
    position_error: np.ndarray
    distance: np.ndarray  # (T, 2)
    tip: np.ndarray


def _time(arm, model, attempt, duration, rate) -> _Timed:
    times, joints, index = time_path(attempt.path, arm.velocity, arm.acceleration, duration, rate)
    tip = arm.fk(joints)[:, :3, 3]
    wanted = CubicSpline(np.arange(len(attempt.points)), attempt.points)(index)
    distance, _ = model.measure(joints)
    return _Timed(times, joints, index / (len(attempt.points) - 1), np.linalg.norm(tip - wanted, axis=1), distance, tip)


def _untimely(arm, model, attempt, duration, rate) -> _Timed:
    """A motion along an infeasible path, to look at; where even that has no timing, its first posture held."""
    try:
        return _time(arm, model, attempt, duration, rate)
    except ValueError:
        return _time(arm, model, replace(attempt, path=attempt.path[:1]), duration, rate)


def _timed_refusal(model, timed, index, margin) -> str:
    """The last check, on the motion as it will be performed."""
    worst = int(timed.position_error.argmax())
    t, error = timed.waypoint[worst], timed.position_error[worst]
    if error > POSITION_TOLERANCE:
        return f"{title(index)}: at t = {t:.2f} the timed motion is {1e3 * error:.1f} mm off the path"
    return swept_refusal(model, timed.joints, timed.waypoint, index, margin - RESOLUTION)


def _plan(arm, timed, refusals, chosen, samples, way, moved, feasible) -> Plan:
    said = tuple(refusals[k] for k in sorted(refusals) if k >= 0)
    return Plan(
        timed.times,
        timed.joints,
        arm.joint_names,
        timed.position_error,
        timed.distance[:, WORLD],
        timed.distance[:, ITSELF],
        timed.tip,
        said,
        samples,
        chosen,
        feasible,
        way,
        moved,
    )
