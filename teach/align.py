"""Common time: which points of different strokes show the same moment of the motion.

Notation
    s        arc length along a stroke over its whole, in [0, 1], measured with a ruler: along chords of one ruler's
             length, so that a hand's trembling, which adds length where it draws slowly, adds none
    z_v(s)   mean stroke of view v [px]
    l(u)     lag: z_1(u - l / 2) and z_2(u + l / 2) show the same moment; a Gaussian process that is 0 at both ends
    e(u)     their signed Sampson distance [px] to the cameras' epipolar geometry (Hartley and Zisserman 2004, eq. 11.9)

A line that runs towards one camera is short in its view and long in the other's: equal arc length is not the same
moment then. "aligned" takes t = u with the most probable lag,

    min_l  e(l)^T E^-1 e(l) + l^T L^-1 l         E covariance of a hand's smooth faults, L of the lag

by Gauss-Newton from l = 0. How large E is, the strokes tell by how they differ within a view, up to a factor; that
factor and how large L is are those of the highest evidence N(e - (de/dl) l; 0, E + (de/dl) L (de/dl)^T). Where a stroke
runs along epipolar lines e hardly depends on l, and the lag stays with the prior: equal arc length where geometry is
silent.
"""

from collections.abc import Sequence

import numpy as np

from scene.camera import Camera
from teach.sketch import Sketch, SketchError, Stroke

COMMON = ("aligned", "arc_length", "drawn")
RULER = 0.03
"""Length of the ruler over the diagonal of the stroke's bounding box."""
COUNT = 100
"""Points at which views are compared."""
LAGS, LAG_LENGTH = (0.01, 0.02, 0.04, 0.08, 0.16), 0.2
"""Standard deviations of the lag to choose from and its correlation length, both of the whole arc length."""
FACTORS, FACTOR_SPREAD = (1.0, 2.0, 4.0), 0.7
"""Times that the faults of views vary more than the few strokes within them, to choose from; prior spread of its
logarithm."""
FAULT, FAULT_LENGTH = 0.03, 0.13
"""A single stroke's RMS fault over its diagonal, where there is no second to tell, and the correlation length of all
faults."""


def common_times(sketches: Sequence[Sketch], time: str) -> list[list[np.ndarray]]:
    """For each motion stroke of each sketch the times (N,) in [0, 1] of its points. time: one of COMMON. Raises
    SketchError."""
    if time not in COMMON:
        raise ValueError(f"time is one of {', '.join(COMMON)}, not {time!r}")
    if time == "drawn":
        return [[drawn(stroke) for stroke in sketch.motions] for sketch in sketches]
    along = [[arc_length(stroke) for stroke in sketch.motions] for sketch in sketches]
    if time == "arc_length" or len(sketches) == 1:  # one view has none to be aligned with
        return along
    s, t = np.linspace(0, 1, COUNT), view_times(sketches, along)
    return [[np.interp(stroke, s, t_view) for stroke in view] for view, t_view in zip(along, t, strict=True)]


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


def view_times(sketches: Sequence[Sketch], along) -> np.ndarray:
    """Common time (V, COUNT) of each view's mean stroke at COUNT even arc lengths.

    The first view is compared with each other one; its own time is the mean of what these say.
    """
    views = [
        np.stack([resample(stroke, times, COUNT) for stroke, times in zip(sketch.motions, view, strict=True)])
        for sketch, view in zip(sketches, along, strict=True)
    ]
    s, cameras = np.linspace(0, 1, COUNT), [sketch.camera for sketch in sketches]
    other = [
        np.interp(s, *correspondence(views[0], view, cameras[0], camera))
        for view, camera in zip(views[1:], cameras[1:], strict=True)
    ]
    first = np.mean([(s + b) / 2 for b in other], axis=0)
    return np.stack([first, *[np.interp(s, b, first) for b in other]])


def correspondence(strokes_a, strokes_b, camera_a: Camera, camera_b: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Arc lengths (COUNT,) along a and along b that show the same moments, both from 0 to 1 and not decreasing.

    strokes_a (A, COUNT, 2), strokes_b (B, COUNT, 2) [px]: the strokes of two views at even arc lengths.
    """
    a, b, F = strokes_a.mean(axis=0), strokes_b.mean(axis=0), fundamental(camera_a, camera_b)
    u = np.linspace(0, 1, len(a))
    distance = lambda lag: sampson(_at(a, u - lag / 2), _at(b, u + lag / 2), F)
    variance = _variance_of_mean([sampson(stroke, b, F) for stroke in strokes_a], a)
    variance += _variance_of_mean([sampson(a, stroke, F) for stroke in strokes_b], b)
    E = variance * (_kernel(u, FAULT_LENGTH) + 0.05 * np.eye(len(u)))
    L = _pinned(_kernel(u, LAG_LENGTH))
    options = [
        _most_probable_lag(distance, factor * E, size**2 * L, -0.5 * (np.log(factor) / FACTOR_SPREAD) ** 2)
        for size in LAGS
        for factor in FACTORS
    ]
    lag = max(options, key=lambda option: option[0])[1]
    return _monotone(u - lag / 2), _monotone(u + lag / 2)


def _most_probable_lag(distance, E, L, log_prior: float, steps: int = 20) -> tuple[float, np.ndarray]:
    """Log evidence and the lag (N,) that minimises the objective; lag = L weights, so that L may be singular."""
    h, damping = 0.5 / len(E), 1.0
    inverse = np.linalg.inv(E)
    objective = lambda e, weights: e @ inverse @ e + weights @ L @ weights
    weights, lag = np.zeros(len(E)), np.zeros(len(E))
    e = distance(lag)
    for _ in range(steps):
        g = (distance(lag + h) - distance(lag - h)) / (2 * h)
        # Minimiser of the objective with e linearised: L g (g L g + E)^-1 (g lag - e)
        target = g * np.linalg.solve(g[:, None] * L * g + E, g * lag - e)
        trial = weights + damping * (target - weights)
        e_trial = distance(L @ trial)
        gain = objective(e, weights) - objective(e_trial, trial)
        if gain > 0:
            weights, e, damping = trial, e_trial, min(1.0, 2 * damping)
            lag = L @ weights
        else:
            damping /= 4
        if damping < 0.01 or 0 <= gain < 1e-3:
            break
    g = (distance(lag + h) - distance(lag - h)) / (2 * h)
    spread, offset = g[:, None] * L * g + E, e - g * lag
    return log_prior - 0.5 * (offset @ np.linalg.solve(spread, offset) + np.linalg.slogdet(spread)[1]), lag


def fundamental(camera_a: Camera, camera_b: Camera) -> np.ndarray:
    """F (3, 3) with (b, 1)^T F (a, 1) = 0 for pixels a, b of the same point; scaled to norm 1."""
    epipole = camera_b.projection @ np.append(camera_a.centre, 1.0)
    cross = np.array([[0, -epipole[2], epipole[1]], [epipole[2], 0, -epipole[0]], [-epipole[1], epipole[0], 0]])
    F = cross @ camera_b.projection @ np.linalg.pinv(camera_a.projection)
    return F / np.linalg.norm(F)


def sampson(a, b, F) -> np.ndarray:
    """Signed Sampson distance (N,) [px] of pixels a and b (N, 2): to first order how far all four numbers must move,
    RSS."""
    a, b = (np.column_stack([x, np.ones(len(x))]) for x in (a, b))
    lines_b, lines_a = a @ F.T, b @ F  # epipolar lines of a in the picture of b, and of b in the picture of a
    gradient = np.sqrt((lines_b[:, :2] ** 2).sum(-1) + (lines_a[:, :2] ** 2).sum(-1))
    return (lines_b * b).sum(-1) / np.maximum(gradient, 1e-300)


def _variance_of_mean(distances, mean) -> float:
    """Variance [px^2] of the mean of a view's strokes across epipolar lines, from their Sampson distances (S, N)
    [px]."""
    guess = FAULT**2 * (np.ptp(mean, axis=0) ** 2).sum() / 2
    if len(distances) == 1:
        return max(guess, 1e-6)
    return max(np.var(distances, axis=0, ddof=1).mean() / len(distances), 1e-4 * guess, 1e-6)


def _at(curve, fractions) -> np.ndarray:
    """Points of curve (N, 2), given at even fractions, at others (K,); beyond the ends it goes on straight."""
    x = np.asarray(fractions) * (len(curve) - 1)
    i = np.clip(x.astype(int), 0, len(curve) - 2)
    return curve[i] + (x - i)[:, None] * (curve[i + 1] - curve[i])


def _kernel(u, length: float) -> np.ndarray:
    return np.exp(-((u[:, None] - u) ** 2) / (2 * length**2))


def _pinned(K) -> np.ndarray:
    """The covariance K of a process given that it is 0 at its ends."""
    ends = [0, -1]
    return K - K[:, ends] @ np.linalg.solve(K[np.ix_(ends, ends)], K[ends])


def _monotone(fractions) -> np.ndarray:
    """Fractions (N,) that do not decrease, from 0 to 1."""
    fractions = np.clip(np.maximum.accumulate(fractions), 0.0, 1.0)
    return np.concatenate([[0.0], fractions[1:-1], [1.0]])


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
