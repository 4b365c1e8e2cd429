"""Common time: which points of different strokes show the same moment of the motion.

Notation
    s        arc length along a stroke over its whole, in [0, 1], measured with a ruler: along chords of one ruler's
             length, so that a hand's trembling, which adds length where it draws slowly, adds none
    u        moment of the motion in [0, 1]: the same for all strokes; "aligned" by teach.repeats within a view and by
             teach.bundle between views, else s or drawn time
    t(u)     normalised time of the skill: how fast people drew, the median over strokes of d(drawn time) / du
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from teach.bundle import BASIS, COUNT, Bundle, ViewedStroke, pinned
from teach.consensus import consensus
from teach.curve import directions
from teach.epipolar import fundamental, lag_between
from teach.likelihood import DRIFT, DRIFT_LENGTH, as_people, correlation, fit_mean, projection
from teach.repeats import lags_of_repeats
from teach.sketch import Event, Sketch, SketchError, Stroke

COMMON = ("aligned", "arc_length", "drawn")
SPEEDS = ("drawn", "uniform")
RULER = 0.03
"""Length of the ruler over the diagonal of the stroke's bounding box."""
SMOOTHING, SLOWEST = 0.05, 4.0
"""Of the drawn speed: its smoothing in u, and how many times slower or faster than on average it may be."""


@dataclass(frozen=True, eq=False)
class CommonTime:
    """times: for each motion stroke of each sketch those of its points (N,), not decreasing, in [0, 1]. agree: (V,),
    which views draw the same motion. off: (V,) [px], how far each is from it; nan where nobody looked. rivals: views that
    may contradict instead of one that does not agree. gain: log evidence that those that agree show one motion. bundle: what "aligned"
    found. drift: RMS of how far a view's strokes run ahead of each other or behind, of the arc length. time: (COUNT,), of even moments."""

    times: list[list[np.ndarray]]
    agree: Bool[np.ndarray, " V"]
    off: Float[np.ndarray, " V"]
    rivals: tuple[int, ...] = ()
    gain: float = np.inf
    bundle: Bundle | None = None
    drift: float = 0.0
    time: Float[np.ndarray, " N"] | None = None

    def uncertainty(self, basis, smoothness: float) -> np.ndarray:
        """(3M, 3M) [m^2] covariance of the mean's weights in ``basis``, as far as "aligned" leaves the curve open across its
        own direction: along it, moments would only be named otherwise."""
        tangent = directions(self.bundle.points)
        across = np.eye(3) - tangent[:, :, None] * tangent[:, None]
        Psi = np.kron(BASIS(np.linspace(0, 1, COUNT)), np.eye(3))
        spread = np.einsum("tab,tbuc,udc->taud", across, (Psi @ self.bundle.covariance @ Psi.T).reshape(COUNT, 3, COUNT, 3), across,
                           optimize=True).reshape(3 * COUNT, -1)  # fmt: skip
        return self._of_weights((spread + spread.T) / 2, basis, smoothness)

    def drifting(self, basis, mean, smoothness: float) -> np.ndarray:
        """(3M, 3M) [m^2] covariance of the weights, of mean (M, 3), of strokes that run ahead or behind by ``drift``."""
        if self.drift == 0:
            return np.zeros((mean.size, mean.size))
        u = np.linspace(0, 1, COUNT)
        drift = pinned(correlation(u, DRIFT_LENGTH))
        velocity = np.gradient(basis(self.time) @ mean, u, axis=0)
        spread = velocity[:, :, None, None] * drift[:, None, :, None] * velocity
        return self._of_weights(self.drift**2 * spread.reshape(3 * COUNT, -1) / np.diag(drift).mean(), basis, smoothness)

    def weights_of(self, displacements, basis, smoothness: float) -> np.ndarray:
        """The weights (M, 3) of displacements (COUNT, 3) [m] at even moments."""
        t = np.linspace(0, 1, 2 * COUNT)
        even = np.stack([np.interp(t, self.time, axis) for axis in displacements.T], axis=1)
        return fit_mean(basis, t, even, np.ones(len(t), dtype=bool), smoothness)

    def _of_weights(self, spread, basis, smoothness: float) -> np.ndarray:
        """The covariance of points at even moments (3 COUNT, 3 COUNT) as one of weights."""
        G = np.kron(projection(basis, self.time, np.gradient(self.time), smoothness), np.eye(3))
        return G @ spread @ G.T


def common_times(sketches: Sequence[Sketch], time: str = "aligned", speed: str = "drawn", robust: bool = True) -> CommonTime:
    """Common time of all motion strokes. time: one of COMMON. speed: of the skill, one of SPEEDS; where ``time`` is
    "drawn" it is that of each stroke. robust: leave out views that contradict the others. Raises SketchError."""
    if time not in COMMON:
        raise ValueError(f"time is one of {', '.join(COMMON)}, not {time!r}")
    if speed not in SPEEDS:
        raise ValueError(f"speed is one of {', '.join(SPEEDS)}, not {speed!r}")
    everyone, unknown, more = np.ones(len(sketches), dtype=bool), np.full(len(sketches), np.nan), {}
    if time == "drawn":
        return CommonTime([[drawn(stroke) for stroke in sketch.motions] for sketch in sketches], everyone, unknown)
    moments = [[arc_length(stroke) for stroke in sketch.motions] for sketch in sketches]
    length, drift = np.linspace(0, 1, COUNT), 0.0
    if time == "aligned":
        moments, drift = _together(sketches, moments)
    if time == "aligned" and len(sketches) > 1:
        found = consensus([viewed(sketch, along) for sketch, along in zip(sketches, moments, strict=True)], robust)
        everyone, unknown, more = found.agree, found.off, {name: getattr(found, name) for name in ("rivals", "gain", "bundle")}
        moments = _moments(moments, found)
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(found.bundle.points, axis=0), axis=1))])
    u = np.linspace(0, 1, COUNT)
    t = length / length[-1] if speed == "uniform" else speed_profile(sketches, moments)
    return CommonTime([[np.interp(moment, u, t) for moment in view] for view in moments], everyone, unknown, drift=drift, time=t, **more)


def viewed(sketch: Sketch, along) -> ViewedStroke:
    """The mean of a view's strokes; ``along``: moments of their points."""
    strokes = [resample(stroke, s, COUNT) for stroke, s in zip(sketch.motions, along, strict=True)]
    return ViewedStroke.of(sketch.camera, strokes)


def _together(sketches, along) -> tuple[list[list[np.ndarray]], float]:
    """For each view the moments that its strokes have in common, of each of their points, given their arc lengths; and
    their RMS drift."""
    u, moments, squares, free = np.linspace(0, 1, COUNT), [], 0.0, 0
    for sketch, view in zip(sketches, along, strict=True):
        lags = lags_of_repeats([resample(stroke, s, COUNT) for stroke, s in zip(sketch.motions, view, strict=True)])
        moments.append([np.interp(s, monotone(u + lag), u) for s, lag in zip(view, lags, strict=True)])
        squares, free = squares + (lags**2).mean(axis=1).sum(), free + len(lags) - 1
    return moments, float(np.sqrt(as_people(squares / max(free, 1), DRIFT**2, free)))


def _moments(along, found) -> list[list[np.ndarray]]:
    """u of each point, given s: z(u + l) shows moment u. A view that contradicts the others keeps u = s."""
    u, lags, moments = np.linspace(0, 1, COUNT), iter(found.bundle.lags), []
    for view, agrees in zip(along, found.agree, strict=True):
        s = monotone(u + next(lags)) if agrees else u
        moments.append([np.interp(stroke, s, u) for stroke in view])
    return moments


def speed_profile(sketches: Sequence[Sketch], moments) -> np.ndarray:
    """t (COUNT,) of even moments u: the median over the strokes of how long they took for each moment."""
    u, paces = np.linspace(0, 1, COUNT), []
    for sketch, view in zip(sketches, moments, strict=True):
        for stroke, at in zip(sketch.motions, view, strict=True):
            if stroke.duration > 0:
                pace = np.diff(np.interp(u, at, drawn(stroke))) * (COUNT - 1)
                paces.append(gaussian_filter1d(pace, SMOOTHING * COUNT, mode="nearest"))
    if not paces:
        return u
    pace = np.clip(np.median(paces, axis=0), 1 / SLOWEST, SLOWEST)
    t = np.concatenate([[0.0], np.cumsum(pace)])
    return t / t[-1]


def monotone(fractions) -> np.ndarray:
    """Fractions (N,) that do not decrease, from 0 to 1."""
    fractions = np.clip(np.maximum.accumulate(fractions), 0.0, 1.0)
    return np.concatenate([[0.0], fractions[1:-1], [1.0]])


def resample(stroke: Stroke, times, count: int) -> np.ndarray:
    """The stroke whose points have ``times`` (N,) at ``count`` even times: (count, 2) [px]."""
    return stroke.at(np.interp(np.linspace(0, 1, count), times, stroke.arc_length))


def arc_length(stroke: Stroke) -> np.ndarray:
    """Time of each of the stroke's points (N,) by arc length s; not decreasing."""
    points, fine = stroke.points, stroke.arc_length
    knots = _chords(points, RULER * np.linalg.norm(np.ptp(points, axis=0)))
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[knots], axis=0), axis=1))])
    if lengths[-1] <= 0:
        return fine
    return np.interp(fine, fine[knots], lengths / lengths[-1])


def drawn(stroke: Stroke) -> np.ndarray:
    """Time of each of the stroke's points (N,) in [0, 1] as it was drawn."""
    if stroke.duration <= 0:
        raise SketchError("a stroke took no time to draw: fit with time=arc_length")
    return (stroke.times - stroke.times[0]) / stroke.duration


def oriented(sketches: Sequence[Sketch]) -> tuple[list[Sketch], list[str]]:
    """The sketches with all strokes drawn the way most are, and a sentence for each that was turned round.

    Within a view strokes are compared point by point; between views by what epipolar geometry makes of either way.
    """
    notes, turned = [], []
    for sketch in sketches:
        flips = _flips([resample(stroke, arc_length(stroke), COUNT) for stroke in sketch.motions])
        notes += [f"Stroke {k + 1} on view {sketch.view} was drawn backwards; it is taken the other way round."
                  for k in np.flatnonzero(flips)]  # fmt: skip
        turned.append(_turned(sketch, flips))
    views = [viewed(sketch, [arc_length(stroke) for stroke in sketch.motions]) for sketch in turned]
    backwards = np.array([False, *[_runs_against(views[0], view) for view in views[1:]]])
    if 2 * backwards.sum() > len(views):
        backwards = ~backwards
    for k in np.flatnonzero(backwards):
        turned[k] = _turned(turned[k], [True] * len(turned[k].motions))
        against = "the other views" if len(views) > 2 else f"view {turned[1 - k].view}"
        notes.append(f"View {turned[k].view} was drawn from the other end than {against}; it is taken the other way round.")
    return turned, notes


def _flips(strokes) -> np.ndarray:
    """Which of a view's strokes (COUNT, 2) run against most others."""
    distance = lambda a, b: np.linalg.norm(a - b, axis=1).mean()
    flips = np.array([distance(stroke[::-1], strokes[0]) < 0.5 * distance(stroke, strokes[0]) for stroke in strokes])
    return ~flips if 2 * flips.sum() > len(flips) else flips


def _runs_against(a: ViewedStroke, b: ViewedStroke) -> bool:
    """Whether the views' strokes meet well only if one is read backwards."""
    F, sigma = fundamental(a.camera, b.camera), np.hypot(a.sigma, b.sigma) / np.sqrt(2)
    along, against = (min(lag_between(a.mean, z, F, sigma, size)[1] for size in (0.12, 0.5)) for z in (b.mean, b.mean[::-1]))
    return along > 6.0 and against < 0.3 * along


def _turned(sketch: Sketch, flips) -> Sketch:
    flip = iter(flips)
    return replace(sketch, strokes=tuple(backwards(s) if s.kind == "motion" and next(flip) else s for s in sketch.strokes))


def backwards(stroke: Stroke) -> Stroke:
    """The stroke as if it had been drawn from its end to its start."""
    last = stroke.times[0] + stroke.times[-1]
    events = tuple(Event(event.name, float(last - event.time)) for event in reversed(stroke.events))
    pressure = None if stroke.pressure is None else stroke.pressure[::-1]
    return replace(stroke, points=stroke.points[::-1], times=last - stroke.times[::-1], events=events, pressure=pressure)


def _chords(points, ruler: float) -> list[int]:
    """Indices of points, first and last included, each the first that is a ruler away from the one before."""
    knots, last = [0], points[0]
    for k, point in enumerate(points):
        if (point[0] - last[0]) ** 2 + (point[1] - last[1]) ** 2 >= ruler * ruler:
            knots.append(k)
            last = point
    if knots[-1] != len(points) - 1:
        knots.append(len(points) - 1)
    return knots
