"""plan: a distribution of trajectories becomes one checked and timed motion.

    0. Go to where the motion begins, if the hand is elsewhere (approach.py).
    1. Condition the distribution on where the hand is. The candidates are its mean and samples of it; where the skill
       knows several ways, the mean of each and samples of each by its share.
    2. For each, find a joint path that keeps the tip on it (postures.py: which way the hand is turned is free unless
       taught) and measure its clearance to the world and to the arm itself, swept between waypoints (collision.py).
       All profiles are tried on the mean; the samples begin with those that served the mean best (attempt.py).
       A mean that is refused is moved away from what it meets, as little as its distribution says (deform.py); an end out of
       reach gives way to the nearest place within it, if the distribution has it so near.
    3. Of the feasible candidates take the most likely, where being less than ``comfortable`` clear counts too: the square of
       what is missing, and at the margin twice what parts a typical sample from the mean.
    4. Time it (timing.py) and check the timed motion once more, as it will be performed.
    5. If none is feasible from where a robot with legs stands, it walks to where one is (base.py), and plans there anew.

Likelihood is compared by the squared Mahalanobis distance to the conditioned mean, averaged over the path.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from robot import base
from robot.approach import BESIDE, beginnings
from robot.approach import approach as approach_path
from robot.attempt import RESOLUTION, Attempt, Search, swept_refusal, title
from robot.collision import ITSELF, WORLD, CollisionModel
from robot.contact import closing, hand_of, touching
from robot.deform import Moved, moved_mean, within_reach
from robot.inverse import NoSolution, tool_of
from robot.keepout import regions_of
from robot.motion import Plan
from robot.timing import time_path

MOVED = -1  # the index of the first way's moved mean; that of the second is one below
BEGINNINGS = 4  # postures where the motion begins that are tried to get to
ADVICE = "robot.planner.approach=null bends the motion to begin where the hand is"
AT_THE_END, SNAPPED = 0.97, 0.015  # share of a motion's time; m, of its end from what it is to touch there
KEPT = 0.005  # m, deviation of where samples end from where the mean does, each axis
BARELY = 6.0  # what being no clearer than the margin costs, in squared deviations: twice what a sample is off in expectation
SLOW = 10  # times as long as it was drawn, of which one is told
STANDS = ("here", "walk", "say")
POSITION_TOLERANCE = 2e-3  # m, of the timed motion against the candidate


def plan(
    skill,
    arm,
    world,
    *,
    start=None,
    seed=0,
    samples=20,
    waypoints=150,
    margin=0.01,
    comfortable=0.03,
    postures=12,
    rate=50.0,
    moved=0.2,
    keep_out=(),
    outlined_for=None,
    held=(),
    approach=0.15,
    orientation=None,
    orientation_tolerance=0.0,
    starts_within=0.0,
    stand="walk",
) -> Plan:
    """Choose, check and time a motion of the arm among the bodies of the world.

    skill: Skill. arm: Arm. world: Obstacles of a World (or anything with ``client`` and ``bodies``; what it ``held`` moves
    with the hand, what is to ``touch`` only the other links keep clear of), None for free space. start (J,)
    [rad]: the present posture (home). seed: of the samples. samples: candidates, the mean among them. waypoints: of
    each path. margin [m]: least clearance to anything. comfortable [m]: clearance beyond which more is no better. postures:
    end postures tried on the mean. rate [Hz]: samples of the plan. moved [m]: how far a mean that is refused may be moved at
    most, 0 for not at all. keep_out: boxes to keep out of, see keepout.py. outlined_for: the only links that must
    keep out of the regions that skill.keep_out outlines, all where it is None. held: bodies that the hand carries
    from the start. approach [m]: where the hand is farther from where the motion was taught to begin, it goes there
    first; nearer, or where this is None, the motion is conditioned to begin at the hand. orientation: of the hand,
    where the skill says none: None or "free", "keep", "down", "tangent", or an axis [x, y, z] that it points along;
    kept within orientation_tolerance [rad] once the hand has turned there. starts_within [m]: the hand does not begin
    where ``start`` has it but at random this near to there, to see what becomes of a motion from elsewhere. stand:
    what becomes of a motion that is feasible from nowhere near: "here", it is refused; "walk", a robot with legs goes
    to stand where it is feasible; "say", it is said of an arm too where its base would have to stand.
    Regions are kept clear of as if they were bodies. A skill with a "contact" at its end ends where the hand touches what is
    there, its fingers closed if they do nothing on the way (contact.py). The motion takes at least ``skill.duration``. Raises ValueError where
    the start itself is out of limits or too close to something, or its fingers when they close there, NoSolution where the beginning cannot be reached,
    SketchError where outlines bound no region.
    """
    if samples < 1 or waypoints < 2:
        raise ValueError(f"a plan needs at least 1 sample and 2 waypoints, not {samples} and {waypoints}")
    if stand not in STANDS:
        raise ValueError(f"stand is one of {', '.join(STANDS)}, not {stand!r}")
    start = np.array(arm.home if start is None else start, dtype=float)
    held = [*held, *getattr(world, "held", ())]
    if starts_within > 0:
        start = _elsewhere(arm, start, starts_within, seed, held)
    regions, only = regions_of(skill.keep_out, outlined_for, keep_out)
    held = dict.fromkeys(held, start)
    only |= dict.fromkeys(getattr(world, "touch", ()), arm.beside_hand)
    opened, (arm, touch, beside) = arm, _touch(skill, arm, world, held)
    landing = dict.fromkeys(beside, [*hand_of(arm), *held])
    only = {name: links for name, links in only.items() if name not in landing}
    bound = {"only": only, "held": held, "landing": landing}
    model = CollisionModel(arm, world, regions, margin=margin, **bound)
    _check_start(arm, model, start, margin)
    if (arm.gripper.open != opened.gripper.open).any():
        _check_closing(closing(opened, world, regions, start, margin, **bound), margin)
    tool = tool_of(skill.hand or orientation, orientation_tolerance, arm.fk(start)[:3, :3])
    here = Search(arm, model, start, margin, comfortable, postures, tool, touch)
    from_there = lambda begin: _performed(skill, replace(here, start=begin), approach, seed, samples, waypoints, rate, moved)
    try:
        motion, wrong = from_there(start), None
    except NoSolution as error:
        motion, wrong = None, error
    if motion is not None and motion.feasible or stand == "here" or (arm.legs is None and stand != "say"):
        if wrong is not None:
            raise wrong
        return motion
    place = base.search(here, skill, approach, _mount(arm, world))
    if place is None or arm.legs is None:
        return _standing_here(motion, wrong, place)
    why = str(wrong or motion.sentence).partition(f"; {ADVICE}")[0]
    said = f"it goes to stand {place} first, since from where it stands {why}"
    walked = _way(model, start, place.start, margin, rate, seed, "where it is to stand")
    return replace(_joined(arm, walked, from_there(place.start)), stands=said)


def _performed(skill, search, approach, seed, samples, waypoints, rate, moved) -> Plan:
    """The motion from the search's start: to where the taught one begins, if that is far, and along it."""
    arm = search.arm
    lead = None if approach is None else _lead(skill, search, approach, rate, seed)
    begin = search.start if lead is None else lead.joints[-1]
    motion = _motion(skill, replace(search, start=begin), samples, waypoints, seed, rate, moved)
    return motion if lead is None else _joined(arm, lead, motion)


def _joined(arm, lead, motion) -> Plan:
    """A motion after the way to its beginning; the legs' steps depend on both."""
    both = motion.after(lead, arm.velocity, arm.acceleration)
    if arm.legs and both.feasible:
        arm.walk(both.times, both.joints)
    return both


def _touch(skill, arm, world, held) -> tuple:
    """The arm as it touches, where (3,) [m] a motion that ends with a contact is to, None for any other, and the bodies there."""
    if world is None or not any(event.name == "contact" and event.time > AT_THE_END * skill.duration for event in skill.events):
        return arm, None, []
    end, model = skill.distribution.mean_at([1.0])[0], CollisionModel(arm, world, held=held)
    beside = model.beside(end, SNAPPED)
    return (touching(arm, model, skill.events), end, beside) if beside else (arm, None, [])


def _mount(arm, world) -> str | None:
    """The body that an arm stands on, if the world has one."""
    name = getattr(world, "spec", {}).get("mount", "pedestal")
    return name if arm.legs is None and world is not None and name in world.bodies else None


def _standing_here(motion, wrong, place) -> Plan:
    """What was refused, with where the base would have to stand."""
    said = f"it would be feasible if the base stood {place}" if place else "the base could stand nowhere near where it would be feasible"
    if wrong is not None:
        raise NoSolution(f"{wrong}; {said}")
    return replace(motion, stands=said)


def _elsewhere(arm, start, within, seed, held) -> np.ndarray:
    """A posture whose tip is at random, evenly within a ball, near to where ``start`` has it."""
    if held:
        raise ValueError(f"a hand that holds {', '.join(held)} begins where it took that: leave robot.planner.starts_within at 0")
    rng, pose = np.random.default_rng([seed, 1]), arm.fk(start)
    away = rng.normal(size=3)
    pose[:3, 3] += within * rng.uniform() ** (1 / 3) * away / np.linalg.norm(away)
    return arm.ik(pose, start=start, position_only=True)


def _lead(skill, search, approach, rate, seed) -> Plan | None:
    """The motion to where the taught one begins, None where the hand is nearer to that than ``approach`` [m]."""
    arm, model, start, margin = search.arm, search.model, search.start, search.margin
    tip, begin = arm.fk(start), skill.distribution.mean_at([0.0])[0]
    if np.linalg.norm(tip[:3, 3] - begin) <= approach:
        return None
    clear = beginnings(model, start, begin, margin + BESIDE, seed)
    where = f"where the motion begins ({', '.join(f'{x:.3f}' for x in begin)}) m"
    if not clear:
        raise NoSolution(f"no posture of {arm.name} has the hand {where} and is clear; {ADVICE}")
    refused = []
    for posture in clear[:BEGINNINGS]:
        try:
            return _way(model, start, posture, margin, rate, seed, where)
        except NoSolution as error:
            refused.append(error)
    raise NoSolution(f"{refused[0]}; {ADVICE}")


def _way(model, start, end, margin, rate, seed, where) -> Plan:
    """The timed motion from one posture to another among what stands around. Raises NoSolution."""
    arm = model.arm
    try:
        path = approach_path(model, start, end, min(margin + BESIDE, *model.clearance(np.stack([start, end]))), seed)
        times, joints, index = time_path(path, arm.velocity, arm.acceleration, 0.0, rate)
    except ValueError as error:
        raise NoSolution(f"on the way to {where}: {error}") from None
    distance, _ = model.measure(joints)
    timed = _Timed(times, joints, index / (len(path) - 1), np.zeros(len(times)), distance, arm.fk(joints)[:, :3, 3])
    refusal = _timed_refusal(model, timed, 0, margin)
    if refusal:
        raise NoSolution(f"on the way to {where}: {refusal.partition(': ')[2]}")
    return _plan(arm, timed, {}, 0, 0, 0, "", True)


def _motion(skill, search, samples, waypoints, seed, rate, moved) -> Plan:
    """The taught motion from the search's start on."""
    arm, model = search.arm, search.model
    comfortable = -np.inf if search.lands else search.comfortable  # all that land come near to something
    ways = skill.starting_at(arm.fk(search.start)[:3, 3])[:samples]
    ways, ends = zip(*(within_reach(search, way, moved) for way in ways))
    candidates, way = _candidates(ways, samples, waypoints, seed, search.ends_clear)
    attempts = search.all(candidates, None if skill.hand else skill.orientation)
    detours = _detours(search, ways, attempts, moved)
    said = "; ".join(_said(detour, index) for index, detour in detours.items())
    attempts += [detour.attempt for detour in detours.values() if detour]
    way = dict(enumerate(way)) | {index: MOVED - index for index in detours}
    unlikely = {a.index: _unlikely(ways[way[a.index]], a.points) for a in attempts}
    refusals = {a.index: a.refusal for a in attempts if a.refusal}
    for attempt in _in_order(attempts, unlikely, search.margin, comfortable):
        try:
            timed = _time(arm, model, attempt, skill.duration, rate)
            refusals[attempt.index] = _timed_refusal(model, timed, attempt.index, search.margin)
        except ValueError as error:
            refusals[attempt.index] = f"{title(attempt.index)}: {error}"
        if not refusals[attempt.index]:
            del refusals[attempt.index]
            chosen = _plan(arm, timed, refusals, attempt.index, samples, int(way[attempt.index]), said, True)
            return replace(_touching(chosen, search), slow=_slow(timed.times[-1], skill.duration), ends=ends[chosen.way])
    least_bad = max((a for a in attempts if a.index >= 0), key=lambda a: a.rank)
    timed = _untimely(arm, model, least_bad, skill.duration, rate)
    refused = _plan(arm, timed, refusals, least_bad.index, samples, int(way[least_bad.index]), said, False)
    return replace(_touching(refused, search), ends=ends[refused.way])


def _touching(motion, search) -> Plan:
    """The plan with where and how the hand is to touch, if it is to."""
    if not search.lands:
        return motion
    return replace(motion, touch=search.touch, contact=search.arm.contact, fingers=search.arm.gripper.open)


def _slow(takes, drawn) -> str:
    """What is said of a motion whose seconds are many times those that were drawn: the joints go a long way for it."""
    return f"beware: it takes {takes / drawn:.0f} times the {drawn:.1f} s that were drawn" if takes > SLOW * drawn else ""


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


def _check_closing(near, margin):
    if near:
        raise ValueError(f"the motion ends with a contact, so the fingers close at the start: there {near[0]} comes within {1e3 * margin:.0f} mm "
                         f"of {near[1]}; start the arm elsewhere")  # fmt: skip


def _candidates(ways, samples, waypoints, seed, ends_clear):
    """Paths (samples, N, 3), the means of the ways first, and whose way each goes (samples,). ends_clear(mean): whether the arm
    can be where it ends; then samples end there too, as the motion is meant to."""
    t, rng = np.linspace(0, 1, waypoints), np.random.default_rng(seed)
    counts = np.diff(np.round((samples - len(ways)) * np.cumsum([0.0] + [way.share for way in ways])).astype(int))
    paths = []
    for way, count in zip(ways, counts, strict=True):
        drawn, mean = way.distribution, way.distribution.mean_at(t)
        if np.isfinite(mean).all() and ends_clear(mean):
            drawn = drawn.condition(1.0, mean[-1], KEPT**2 * np.eye(3))
        paths.append(np.concatenate([mean[None], drawn.sample(count, t, rng)]))
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


def _in_order(attempts, unlikely, margin, comfortable) -> list[Attempt]:
    """The feasible ones, the best first: likely, and clear."""

    def cost(attempt):
        missing = max(comfortable - attempt.clearance, 0.0) / max(comfortable - margin, 1e-9)
        return unlikely[attempt.index] + BARELY * missing**2

    return sorted((a for a in attempts if not a.refusal), key=cost)


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
    if model.arm.legs:
        try:
            model.arm.walk(timed.times, timed.joints)
        except NoSolution as error:
            return f"{title(index)}: the legs cannot follow: {error}"
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
