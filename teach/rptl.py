"""Ray-tracing Probabilistic Trajectory Learning (RPTL): sketches on two or more views -> a skill (Zhi et al. 2023).

    sketches ─ common time ─ densities per view ─ Algorithm 1 ─ Gaussian weights ─ skill
               strokes        density.py           raytrace.py   likelihood.py       trajectory.py
"""

import time as clock
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from itertools import combinations

import numpy as np
import torch

from scene.camera import Camera
from teach.align import common_times, resample
from teach.basis import SquaredExponential
from teach.contact import CONTACT, contacts, touch
from teach.contact import warnings as contact_warnings
from teach.density import Flow
from teach.likelihood import fit_coherent, fit_diagonal, fit_mean, hand_prior, moments_over_time
from teach.raytrace import Algorithm1, Intersections
from teach.sketch import Event, Sketch, SketchError, check, ray_angle
from teach.surface import fit_surface
from teach.trajectory import Skill, TrajectoryDistribution

POINTS = 100
"""Points at even times by which a stroke is represented while fitting."""


def fit(
    sketches: Sequence[Sketch],
    *,
    seed: int = 0,
    density=None,
    raytrace=None,
    basis=None,
    time: str = "aligned",
    covariance: str = "coherent",
    smoothness: float = 1e-8,
    strength: float = 20.0,
    depths: Mapping[str, np.ndarray] | None = None,
    offset: float = 0.0,
) -> Skill:
    """Learn the motion that the sketches draw.

    density: Flow(), or JointFlow() as the paper has it. raytrace: Algorithm1(). basis: SquaredExponential(). time: what
    is common to strokes: "aligned" (epipolar geometry), "arc_length" or the "drawn" time of each, normalised.
    covariance: "coherent" (full, of whole strokes) or "diagonal" (the paper's independent weights). smoothness: penalty
    of the mean's integrated squared acceleration, against its squared error. strength: number of strokes that the
    coherent covariance's prior is worth. depths: by view, depth pictures (h, w) [m along the optical axis, nan
    where nothing is seen]: strokes touch the surface where they have an event "contact", and a motion drawn on one view
    alone is laid on the surface seen there, ``offset`` [m] off it. Raises SketchError.
    """
    started = clock.perf_counter()
    density, raytrace, basis = density or Flow(), raytrace or Algorithm1(), basis or SquaredExponential()
    if covariance not in ("coherent", "diagonal"):
        raise ValueError(f"covariance is 'coherent' or 'diagonal', not {covariance!r}")
    depths = depths or {}
    check(sketches, surfaces=depths)
    drawn = [sketch for sketch in sketches if sketch.motions]
    times = common_times(drawn, time)
    if len(drawn) == 1:
        how = {"offset": offset, "covariance": covariance, "smoothness": smoothness, "strength": strength}
        mean, S, report = fit_surface(drawn[0], depths[drawn[0].view], times[0], basis, count=POINTS, **how)
    else:
        cameras = [sketch.camera for sketch in drawn]
        strokes, densities = view_densities(drawn, times, density, seed=seed)
        with _one_thread():
            pairs = combinations(zip(densities, cameras, strict=True), 2)
            met = [raytrace((p_a, p_b), (camera_a, camera_b), seed=seed) for (p_a, camera_a), (p_b, camera_b) in pairs]
        mean, grid, variance = _mean(basis, met, smoothness)
        if covariance == "diagonal":
            S = np.diag(fit_diagonal(basis, grid, variance).ravel())
        else:
            prior = hand_prior(basis, mean, smoothness)
            S = fit_coherent(_observations(basis, mean, strokes, cameras), prior, strength)
        report = _report(drawn, strokes, densities, met, basis, mean)
    touched = contacts(drawn, times, depths)
    distribution = touch(TrajectoryDistribution(basis, mean, S), touched)
    report["contacts"] = [contact.plain() for contact in touched]
    report["warnings"] += contact_warnings(drawn, touched, depths)
    if offset and len(drawn) > 1:
        report["warnings"].append("The offset is not used: it is for a motion drawn on one view, along a surface.")
    report["seconds"] = clock.perf_counter() - started
    duration = max(float(np.median([stroke.duration for sketch in drawn for stroke in sketch.motions])), 0.1)
    keep_out = tuple(
        Sketch(sketch.view, sketch.camera, outlines)
        for sketch in sketches
        if (outlines := tuple(stroke for stroke in sketch.strokes if stroke.kind == "keep_out"))
    )
    events = tuple(event for event in _events(drawn, times, duration) if not (touched and event.name == CONTACT))
    events += tuple(Event(CONTACT, duration * contact.time) for contact in touched)
    return Skill(distribution, duration, events, None, keep_out, report)


def view_densities(drawn: Sequence[Sketch], times, density, *, seed: int = 0) -> tuple[list, list]:
    """For each view its strokes at ``times`` (teach.align.common_times), (S, POINTS, 2) [px], and their density p(x, y | t)."""
    strokes = [
        np.stack([resample(stroke, at, POINTS) for stroke, at in zip(sketch.motions, view, strict=True)])
        for sketch, view in zip(drawn, times, strict=True)
    ]
    with _one_thread():
        densities = [
            density.fit(view, (sketch.camera.width, sketch.camera.height), seed=seed + number)
            for number, (view, sketch) in enumerate(zip(strokes, drawn, strict=True))
        ]
    return strokes, densities


@contextmanager
def _one_thread():
    """torch on one thread, and as before afterwards: the flows are so small that a second thread only waits for the
    first."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _mean(basis, met: list[Intersections], smoothness: float):
    """Mean of the weights (M, 3), the times (T,) at which rays met, and the points' mean square from the mean there (T,
    3)."""
    grid = met[0].grid
    fields = [np.concatenate([getattr(m, name) for m in met]) for name in ("times", "points", "weights")]
    centre, variance, seen = moments_over_time(*fields, grid)
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
        ((_jacobian(camera, x) @ Psi).reshape(2 * len(t), -1), residual)
        for camera, residual in zip(cameras, residuals, strict=True)
    ]


def _jacobian(camera: Camera, x) -> np.ndarray:
    """Derivative (T, 2, 3) [px/m] of the projection at points x (T, 3)."""
    P = camera.projection
    homogeneous = x @ P[:, :3].T + P[:, 3]
    pixels, depth = homogeneous[:, :2] / homogeneous[:, 2:], homogeneous[:, 2]
    return (P[None, :2, :3] - pixels[:, :, None] * P[None, 2:, :3]) / depth[:, None, None]


def _events(drawn, times, duration: float) -> tuple[Event, ...]:
    """Median over strokes of the time [s] at which each event was marked, on the skill's clock."""
    marked: dict[str, list[float]] = {}
    for sketch, view in zip(drawn, times, strict=True):
        for stroke, at in zip(sketch.motions, view, strict=True):
            for event in stroke.events:
                marked.setdefault(event.name, []).append(float(np.interp(event.time, stroke.times, at)))
    return tuple(Event(name, duration * float(np.median(times))) for name, times in marked.items())


def _report(drawn, strokes, densities, met, basis, mean) -> dict:
    """Plain numbers on the fit, and warnings in sentences."""
    x = basis(np.linspace(0, 1, POINTS)) @ mean
    residual = {}
    for sketch, drawn_points in zip(drawn, strokes):
        miss = drawn_points.mean(axis=0) - sketch.camera.project(x)
        residual[sketch.view] = float(np.linalg.norm(miss, axis=-1).mean())
    angles = [ray_angle(a, b) for a, b in combinations(drawn, 2)]
    counts = np.sum([m.counts for m in met], axis=0)
    return {
        "reprojection_px": residual,
        "ray_angle_deg": float(max(angles)),
        "intersections": counts.tolist(),
        "noise": {sketch.view: density.noise for sketch, density in zip(drawn, densities)},
        "warnings": _warnings(drawn, residual, max(angles), counts),
    }


def _warnings(drawn, residual, angle: float, counts) -> list[str]:
    warnings = []
    if (missing := int((counts == 0).sum())) > 0:
        warnings.append(f"At {missing} of {len(counts)} times no rays meet; the motion is interpolated there.")
    if angle < 15:
        warnings.append(
            f"The views look from nearly the same side ({angle:.0f} degrees apart), so depth is uncertain; sketch on a "
            "view from another side."
        )
    for sketch in drawn:
        outside = np.mean([1 - sketch.camera.contains(stroke.points).mean() for stroke in sketch.motions])
        if outside > 0:
            warnings.append(f"{outside:.0%} of what is drawn on view {sketch.view} lies outside the picture.")
        if (miss := residual[sketch.view]) > 0.05 * sketch.camera.width:
            warnings.append(f"The strokes on view {sketch.view} miss the motion by {miss:.0f} px; draw them again.")
        if len(sketch.motions) < 2:
            warnings.append(f"View {sketch.view} has one stroke: how far the motion may vary is a guess; draw three.")
    return warnings
