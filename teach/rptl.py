"""Ray-tracing Probabilistic Trajectory Learning (RPTL): sketches on two or more views -> a skill (Zhi et al. 2023).

    sketches ─ routes ─ common time ─ densities per view ─ rays ──── Gaussian weights ─ skill
    turns.py   routes.py  align.py      density.py         raytrace.py  likelihood.py     trajectory.py
                                        spread.py: of one hand          parallel.py: what depth pictures add
               a single view with a depth picture ──── surface.py ─────────┘
"""

import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from teach.align import common_times, oriented, resample
from teach.basis import SquaredExponential
from teach.contact import CONTACT, contacts, touch
from teach.contact import warnings as contact_warnings
from teach.density import Flow
from teach.hooks import without_hooks
from teach.hull import visual_hull
from teach.likelihood import fit_coherent, fit_diagonal, fit_mean, hand_prior, mean_uncertainty, moments_over_time
from teach.parallel import parallel_stretch
from teach.periodic import unrolled
from teach.quality import TIMES, contradictions, quality, warnings
from teach.raytrace import ExactRays, Intersections
from teach.routes import split
from teach.orientation import chosen
from teach.sketch import Event, Sketch, SketchError, check, without_slips
from teach.spread import pooled as pooled_strokes
from teach.surface import fit_surface
from teach.trajectory import Route, Skill, TrajectoryDistribution

POOR = -40.0
"""Log evidence below which views hardly show one motion: one in fifty honest sketches, 94 of a hundred unrelated ones."""
POINTS = 100
"""Points at even times by which a stroke is represented while fitting."""


@contextmanager
def _one_thread():
    """numpy and torch on one thread, and as before afterwards: matrices and flows are so small that a second thread only
    waits for the first, and for a core that is free."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        torch.set_num_threads(threads)


@_one_thread()
def fit(
    sketches: Sequence[Sketch],
    *,
    seed: int = 0,
    density=None,
    raytrace=None,
    basis=None,
    time: str = "aligned",
    speed: str = "drawn",
    robust: bool = True,
    routes: bool = True,
    hooks: bool = True,
    periodic: bool | None = None,
    covariance: str = "coherent",
    predictive: bool = True,
    pooled: bool = True,
    parallel: bool = True,
    smoothness: float = 1e-10,
    strength: float = 30.0,
    conditioning: str = "gaussian",
    depths: Mapping[str, np.ndarray] | None = None,
    offset: float = 0.0,
    seen: Callable[[Sketch, object], None] | None = None,
) -> Skill:
    """Learn the motion that the sketches draw.

    density: Flow(), or JointFlow() as the paper has it. raytrace: ExactRays(), or Algorithm1(). basis:
    SquaredExponential(). time: what is common to strokes: "aligned" (geometry), "arc_length" or the "drawn" time of
    each, normalised. speed: of the skill, "drawn" (the median of people's) or "uniform". robust: views that contradict
    the others are left out. routes: strokes that go different ways become different distributions. hooks: those of the pen are
    left out (teach.hooks). periodic: whether
    the motion closes and repeats, None to see it by the strokes (teach.periodic.unrolled) or a periodic basis; the
    skill is a single turn then, in the periodic basis as wide as ``basis``. covariance: "coherent" (full, of whole
    strokes) or "diagonal" (the paper's independent weights). predictive: the coherent covariance is that of a further
    demonstration, which includes how uncertain the mean is and how strokes drift. pooled: of three views or more, densities are of
    strokes that spread as all views together say (teach.spread). parallel: a motion that runs parallel to a surface
    which ``depths`` show behind it is held so (teach.parallel). smoothness: penalty of the mean's integrated squared
    acceleration, against its squared error. strength: number of strokes that the coherent covariance's prior is worth.
    conditioning: how the skill starts where the hand is, "gaussian" or the paper's "first_weight".
    depths: by view, depth pictures (h, w) [m along the optical axis, nan where nothing is seen]: strokes touch the
    surface where they have an event "contact", and a motion drawn on one view alone is laid on the surface seen there,
    ``offset`` [m] off it. seen: is called with each view's sketch and density. Raises SketchError.
    """
    started = clock.perf_counter()
    density, raytrace, basis = density or Flow(), raytrace or ExactRays(), basis or SquaredExponential()
    if covariance not in ("coherent", "diagonal"):
        raise ValueError(f"covariance is 'coherent' or 'diagonal', not {covariance!r}")
    sketches, turns = unrolled(sketches, True if periodic is None and basis.period else periodic)
    basis = basis.wrapped() if turns and not basis.period else basis
    check(sketches, surfaces=depths or ())
    orientation = chosen(sketches)
    regions = visual_hull(sketches)  # outlines that bound nothing are refused before anything is learned
    drawn, slips = without_slips([sketch for sketch in sketches if sketch.motions])
    drawn, caught = without_hooks(drawn) if hooks else (drawn, [])
    drawn, notes = oriented(drawn)
    ways, questions = split(drawn) if routes else ([drawn], [])
    weights = _Weights(basis, covariance, predictive, parallel, smoothness, strength)
    learned = [
        _learn(way, common_times(way, time, speed, robust), (density, raytrace, pooled), weights, depths or {}, offset, seed, seen)
        for way in ways
    ]
    strokes = [sum(len(sketch.motions) for sketch in way) for way in ways]
    report = learned[0].report
    if len(ways) > 1:
        questions.append(f"The strokes go {len(ways)} different ways; each is kept, and planning chooses among them.")
        report["routes"] = [one.report["sentence"] for one in learned]
    report["warnings"] = slips + caught + notes + questions + [w for w in dict.fromkeys(w for one in learned for w in one.report["warnings"])]
    report |= {"turns": turns} if turns else {}
    report["keep_out"] = {region.name: 1e3 * region.volume for region in regions}  # litres
    report["seconds"] = clock.perf_counter() - started
    kept = tuple(Sketch(sketch.view, sketch.camera, sketch.outlines) for sketch in sketches if sketch.outlines)
    shares = np.array(strokes) / sum(strokes) if len(ways) > 1 else ()
    alternatives = tuple(Route(float(p), one.distribution) for p, one in zip(shares, learned, strict=False))
    best = learned[0]
    return Skill(
        best.distribution, best.duration, best.events, orientation, kept, report, routes=alternatives, conditioning=conditioning
    )


@dataclass(frozen=True)
class _Weights:
    """How weights are fitted: settings of ``fit``."""

    basis: object
    covariance: str
    predictive: bool
    parallel: bool
    smoothness: float
    strength: float


@dataclass(frozen=True, eq=False)
class _Learned:
    distribution: TrajectoryDistribution
    duration: float
    events: tuple[Event, ...]
    report: dict


def _learn(drawn, common, parts, weights: _Weights, depths, offset: float, seed: int, seen) -> _Learned:
    """One way of the motion."""
    if len(drawn) == 1:
        how = {name: getattr(weights, name) for name in ("covariance", "smoothness", "strength")}
        mean, S, report = fit_surface(
            drawn[0], depths[drawn[0].view], common.times[0], weights.basis, count=POINTS, offset=offset, **how
        )
        S = S + common.drifting(weights.basis, mean, weights.smoothness) if weights.covariance == "coherent" else S
        distribution = TrajectoryDistribution(weights.basis, mean, S)
    else:
        distribution, report = _from_rays(drawn, common, parts, weights, depths, seed, seen)
        if offset:
            report["warnings"].append("The offset is not used: it is for a motion drawn on one view, along a surface.")
    touched = contacts(drawn, common.times, depths)
    report["contacts"] = [contact.plain() for contact in touched]
    report["warnings"] += contact_warnings(drawn, touched, depths)
    duration = max(float(np.median([stroke.duration for sketch in drawn for stroke in sketch.motions])), 0.1)
    events = tuple(e for e in _events(drawn, common.times, duration) if not (touched and e.name == CONTACT))
    events += tuple(Event(CONTACT, duration * contact.time) for contact in touched)
    return _Learned(touch(distribution, touched), duration, events, report)


def _from_rays(drawn, common, parts, weights: _Weights, depths, seed: int, seen):
    """The distribution and the report of a motion drawn on two or more views."""
    left_out, sentences = contradictions(drawn, common.agree, common.off)
    for k in common.rivals:
        sentences.append(f"It may be the sketch on view {drawn[k].view} instead: draw both of them again, or add a view.")
    if common.gain < POOR:
        views = " and ".join(s.view for s, ok in zip(drawn, common.agree, strict=True) if ok)
        sentences.append(f"The strokes of views {views} hardly show one motion: look at it in a further view, or draw them again.")
    drawn, times = zip(*[(s, t) for s, t, ok in zip(drawn, common.times, common.agree, strict=True) if ok], strict=True)
    density, raytrace, pooled = parts
    cameras = [sketch.camera for sketch in drawn]
    strokes = _at_even_times(drawn, times)
    spread = pooled_strokes(strokes) if pooled and len(strokes) > 2 else strokes  # two rays meet where they do, whatever they weigh
    densities = [
        density.fit(view, (camera.width, camera.height), seed=seed + number)
        for number, (view, camera) in enumerate(zip(spread, cameras, strict=True))
    ]
    met = raytrace(densities, cameras, seed=seed)
    if seen is not None:
        for sketch, p in zip(drawn, densities, strict=True):
            seen(sketch, p)
    basis = weights.basis
    mean, grid, variance = _mean(basis, met, weights.smoothness)
    _require_in_front(basis(TIMES) @ mean, drawn)
    stretch = parallel_stretch(drawn, common.bundle, depths) if weights.parallel and common.bundle else None
    if stretch is not None:
        known, moved = stretch.held(common.bundle, basis(common.time) @ mean, cameras)
        common, mean = replace(common, bundle=known), mean + common.weights_of(moved, basis, weights.smoothness)
    observations = _observations(basis, mean, strokes, cameras)
    S = fit_coherent(observations, hand_prior(basis, mean, weights.smoothness), weights.strength)
    open_ = common.uncertainty(basis, weights.smoothness) if common.bundle else mean_uncertainty(observations, S)
    if weights.covariance == "diagonal":
        S = np.diag(fit_diagonal(basis, grid, variance).ravel())
    elif weights.predictive:  # a further stroke of few is Student's t: its covariance, and how open the mean is
        freedom = weights.strength + sum(len(view) for view in strokes)
        S = S * freedom / max(freedom - 2, 1) + open_ + common.drifting(basis, mean, weights.smoothness)
    distribution = TrajectoryDistribution(basis, mean, S)
    uncertainty = TrajectoryDistribution(basis, mean, open_).covariance_at(TIMES)
    report = quality(drawn, strokes, distribution, uncertainty)
    if stretch is not None:
        report["parallel"] = stretch.plain()
        report["sentence"] += f" {stretch.sentence}"
    report["intersections"] = met.counts.tolist()
    report["noise"] = {sketch.view: density.noise for sketch, density in zip(drawn, densities, strict=True)}
    report["contradicting"] = {view: miss if np.isfinite(miss) else None for view, miss in left_out.items()}
    seen_as = report["reprojection_px"], report["spread_px"], report["ray_angle_deg"], met.counts
    report["warnings"] = sentences + warnings(drawn, distribution.mean_at(TIMES), *seen_as)
    return distribution, report


def _require_in_front(points, drawn) -> None:
    """Raise SketchError unless all cameras see the points (T, 3) [m]."""
    for sketch in drawn:
        if not np.isfinite(sketch.camera.project(points)).all():
            raise SketchError(
                f"the rays of the views meet behind the camera of view {sketch.view!r}: its sketch or its camera belongs "
                "to another picture; draw it again"
            )


def _at_even_times(drawn, times) -> list[np.ndarray]:
    """For each view its strokes (S, POINTS, 2) [px] at even common times."""
    return [
        np.stack([resample(stroke, at, POINTS) for stroke, at in zip(sketch.motions, view, strict=True)])
        for sketch, view in zip(drawn, times, strict=True)
    ]


def _mean(basis, met: Intersections, smoothness: float):
    """Mean of the weights (M, 3), the times (T,) at which rays met, and the points' mean square from the mean there (T,
    3)."""
    grid = met.grid
    centre, variance, seen = moments_over_time(met.times, met.points, met.weights, grid)
    if seen.sum() < 2:
        raise SketchError(
            f"the rays of the views meet at {seen.sum()} of {len(grid)} times: their strokes do not show the same "
            "motion, or near, far, delta exclude it; draw them again or widen teach.raytrace"
        )
    mean = fit_mean(basis, grid, centre, seen, smoothness)
    return mean, grid[seen], (variance + (centre - basis(grid) @ mean) ** 2)[seen]


def _observations(basis, mean, strokes, cameras) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each view what ``fit_coherent`` takes: H (2T, 3M) [px/m] and residuals from the mean (n, 2T) [px]."""
    t = np.linspace(0, 1, POINTS)[::2]
    x, Psi = basis(t) @ mean, np.kron(basis(t), np.eye(3)).reshape(len(t), 3, -1)
    residuals = [(view - view.mean(axis=0))[:, ::2].reshape(len(view), -1) for view in strokes]
    return [
        ((camera.jacobian(x) @ Psi).reshape(2 * len(t), -1), residual)
        for camera, residual in zip(cameras, residuals, strict=True)
    ]


def _events(drawn, times, duration: float) -> tuple[Event, ...]:
    """Median over strokes of the time [s] at which each event was marked, on the skill's clock, in order of time; what a
    stroke marks twice happens twice."""
    marked: dict[tuple[str, int], list[float]] = {}
    for sketch, view in zip(drawn, times, strict=True):
        for stroke, at in zip(sketch.motions, view, strict=True):
            often: dict[str, int] = {}
            for event in sorted(stroke.events, key=lambda event: event.time):
                often[event.name] = often.get(event.name, 0) + 1
                time = float(np.interp(event.time, stroke.times, at))
                marked.setdefault((event.name, often[event.name]), []).append(time)
    found = [Event(name, duration * float(np.median(at))) for (name, _), at in marked.items()]
    return tuple(sorted(found, key=lambda event: event.time))
