"""One view and a surface: strokes are laid on what the depth picture of their view shows, and become a skill along it.

    strokes at common times ─ surface_points ─ spikes bridged ─ offset along the normals ─ Gaussian weights
                              depth.py         Siegel 1982                                 likelihood.py

A single view does not say how far away a motion is; where it runs along a surface (wiping, writing, pushing on a table)
its depth picture does. Deviations between strokes then lie in the surface, and so do the skill's, but for what depth
itself is uncertain.
"""

from dataclasses import dataclass

import numpy as np

from teach.align import resample
from teach.curve import extent
from teach.depth import ERROR, SAME, surface_points
from teach.likelihood import SMOOTH_LENGTH, correlation, fit_coherent, fit_diagonal, fit_mean, hand_prior, projection
from teach.sketch import Sketch, SketchError

UNSEEN = 0.1
"""A stroke of which more than this share has no surface is refused."""
ROUGH = 0.3
"""So is one where more than this share is unseen or jumps."""
SIDE = 0.22
"""Share of a stroke on each side with which a point is compared; what jumps for less than half of it is bridged."""


@dataclass(frozen=True, eq=False)
class Lifted:
    """Strokes on the surface.

    points: (S, T, 3) [m] at the offset. normals: (S, T, 3) unit vectors towards the camera. bridged: (S,) share of each
    stroke where the surface was unseen or hidden. jumps: (S,) [m] largest jump of the surface between neighbouring
    points, 0 where there is none.
    """

    points: np.ndarray
    normals: np.ndarray
    bridged: np.ndarray
    jumps: np.ndarray


def fit_surface(
    sketch: Sketch,
    depth,
    times,
    basis,
    *,
    count: int,
    offset: float,
    covariance: str,
    smoothness: float,
    strength: float,
) -> tuple[np.ndarray, np.ndarray, dict]:
    """Mean (M, 3) [m] and covariance (3M, 3M) [m^2] of the weights, and the report of the motion drawn on one view.

    depth: (h, w) [m] of the view's picture. times: of its motion strokes' points, from align.common_times. count:
    points by which a stroke is represented. The rest as teach.rptl.fit has it. Raises SketchError where the surface is
    unseen.
    """
    if not np.isfinite(offset):
        raise ValueError(f"offset is a distance [m] from the surface, not {offset}")
    t, lifted = np.linspace(0, 1, count), lift(sketch, depth, times, count, offset)
    centre = lifted.points.mean(axis=0)
    mean = fit_mean(basis, t, centre, np.ones(count, bool), smoothness)
    if covariance == "diagonal":
        squares = ((lifted.points - basis(t) @ mean) ** 2).mean(axis=0)
        S = np.diag(fit_diagonal(basis, t, squares).ravel())
    else:
        # In millimetres, which count as pixels do where the likelihood was made for them.
        H, residuals = 1000 * np.kron(basis(t), np.eye(3)), 1000 * (lifted.points - centre)
        prior = _in_surface(hand_prior(basis, mean, smoothness), basis, t, lifted.normals.sum(axis=0), smoothness)
        S = fit_coherent([(H, residuals.reshape(len(residuals), -1))], prior, strength)
    S = S + _depth_covariance(basis, t, sketch.camera.depth(centre).mean(), smoothness)
    return mean, S, _report(sketch, lifted, offset, basis(t) @ mean)


def lift(sketch: Sketch, depth, times, count: int, offset: float = 0.0) -> Lifted:
    """The motion strokes of a view at ``count`` even common times, ``offset`` [m] along the normals off its surface.

    depth: (h, w) [m], of the view's picture at any resolution. times: of each stroke's points, from align.common_times.
    Raises SketchError where the surface is unseen.
    """
    strokes = [resample(stroke, at, count) for stroke, at in zip(sketch.motions, times, strict=True)]
    laid = [_laid(sketch, depth, pixels, number) for number, pixels in enumerate(strokes)]
    points, normals, bridged, jumps = (np.stack(part) for part in zip(*laid, strict=True))
    return Lifted(points + offset * normals, normals, bridged, jumps)


def _laid(sketch: Sketch, depth, pixels, number: int) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Points and normals (T, 3) of one stroke, pixels (T, 2), the share of it that is bridged, the largest jump [m]."""
    camera = sketch.camera
    points, normals, seen = surface_points(camera, depth, pixels)
    _require(seen, UNSEEN, pixels, f"stroke {number} on view {sketch.view!r} has no surface")
    k = np.arange(len(pixels))
    q = np.interp(k, k[seen], 1 / camera.depth(points[seen]))
    rest, trend = _detrended(q, pixels)
    kept = seen & ~_spikes(rest, SAME * q)
    _require(kept, ROUGH, pixels, f"stroke {number} on view {sketch.view!r} has no smooth surface")
    rest = np.interp(k, k[kept], rest[kept])
    normals = np.stack([np.interp(k, k[kept], normals[kept, axis]) for axis in range(3)], axis=1)
    origins, directions = camera.rays(pixels)
    points = origins + directions / ((trend + rest) * (directions @ camera.forward))[:, None]
    jump = np.abs(np.diff(rest)) > SAME * q[1:]
    jumps = np.linalg.norm(np.diff(points, axis=0), axis=1)[jump]
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True), 1 - kept.mean(), jumps.max(initial=0.0)


def _require(good, share: float, pixels, what: str) -> None:
    """Raise SketchError where more than this share of a stroke's pixels (T, 2) are not good (T,)."""
    if (bad := 1 - good.mean()) > share:
        u, v = np.median(pixels[~good], axis=0)
        raise SketchError(
            f"{what} under {bad:.0%} of it (around pixel {u:.0f}, {v:.0f}): draw it where the depth picture shows a "
            "surface, or sketch the motion on a second view"
        )


def _detrended(q, pixels, steps: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """What remains of q (T,) after the plane (least absolute deviations) that the whole stroke lies on, and that plane.

    A stroke that turns back and forth on a plane has a smooth rest, though its depth turns with it.
    """
    places = np.column_stack([np.ones(len(q)), (pixels - pixels.mean(axis=0)) / extent(pixels)])
    trend = np.full(len(q), np.median(q))
    for _ in range(steps):
        root = np.sqrt(1 / np.maximum(np.abs(q - trend), 1e-4 * SAME * q))
        trend = places @ np.linalg.lstsq(places * root[:, None], q * root, rcond=1e-9)[0]
    return q - trend, trend


def _spikes(values, tolerance) -> np.ndarray:
    """Which of values (T,) lie further than tolerance (T,) from the lines through what is on their left and right.

    A step or a bend is no spike, since it agrees with one side.
    """
    side = round(SIDE * len(values))
    windows = np.lib.stride_tricks.sliding_window_view(values, side + 1)
    left, right = np.full((2, len(values)), np.inf)
    left[side:] = np.abs(_repeated_medians(windows[:, ::-1]) - values[side:])
    right[:-side] = np.abs(_repeated_medians(windows) - values[:-side])
    return np.minimum(left, right) > tolerance


def _repeated_medians(windows) -> np.ndarray:
    """Value (N,) at the first place of each window (N, W) of the line through it that half of the window may miss."""
    k = np.arange(windows.shape[1])
    others = ~np.eye(len(k), dtype=bool)
    differences, steps = windows[:, :, None] - windows[:, None], k[:, None] - k
    slopes = (differences[:, others] / steps[others]).reshape(len(windows), len(k), -1)
    slope = np.median(np.median(slopes, axis=2), axis=1)
    return np.median(windows - slope[:, None] * k, axis=1)


def _in_surface(S, basis, t, normals, smoothness: float) -> np.ndarray:
    """The covariance S (3M, 3M) of deviations without their part along normals (T, 3), of any length, at times t.

    A deviation w has the positions Psi^T w; its tangential part (I - n n^T) Psi^T w is taken back to weights.
    """
    n = normals / np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-300)
    tangential, P = np.eye(3) - n[:, :, None] * n[:, None], projection(basis, t, np.ones(len(t)), smoothness)
    G = np.einsum("it,tab,tj->iajb", P, tangential, basis(t), optimize=True).reshape(S.shape)
    return G @ S @ G.T


def _depth_covariance(basis, t, depth: float, smoothness: float) -> np.ndarray:
    """Covariance (3M, 3M) [m^2] of motions that stray, as smoothly as a hand's do, as far as depth [m] is uncertain.

    Without it no motion would leave the surface, and one that must, to start at a hand above it, would do so wildly.
    """
    P = projection(basis, t, np.ones(len(t)), smoothness)
    strays = (ERROR * depth) ** 2 * correlation(t, SMOOTH_LENGTH)
    return np.kron(P @ strays @ P.T, np.eye(3))


def _report(sketch: Sketch, lifted: Lifted, offset: float, x) -> dict:
    """Plain numbers on the fit of x (T, 3) [m], and warnings in sentences."""
    centre, view = lifted.points.mean(axis=0), sketch.view
    miss_px = np.linalg.norm(sketch.camera.project(centre) - sketch.camera.project(x), axis=1).mean()
    miss_mm = 1000 * np.linalg.norm(centre - x, axis=1).mean()
    surface = {"view": view, "offset_m": float(offset), "miss_mm": float(miss_mm), "bridged": lifted.bridged.tolist()}
    return {"reprojection_px": {view: float(miss_px)}, "surface": surface, "warnings": _warnings(view, lifted, offset)}


def _warnings(view: str, lifted: Lifted, offset: float) -> list[str]:
    where = f"{1000 * offset:.0f} mm off" if offset else "on"
    warnings = [f"The motion is drawn on view {view} alone and runs {where} the surface that its depth picture shows."]
    if (most := lifted.bridged.max()) > 0.05:
        warnings.append(f"Up to {most:.0%} of a stroke on view {view} has no surface or a thing in front: bridged.")
    if (jump := lifted.jumps.max()) > 0:
        warnings.append(
            f"The surface under the strokes on view {view} jumps by {100 * jump:.0f} cm at an object's edge and the "
            "motion with it; draw around the object, or on two views."
        )
    if len(lifted.points) < 2:
        warnings.append(f"View {view} has one stroke: how far the motion may vary is a guess; draw three.")
    return warnings
