"""How good a fit is, in plain numbers and in sentences that a person understands: what to draw again, and where.

Notation
    Sigma(t)    covariance [m^2] of the mean trajectory at t, what few strokes and their rays leave open
    J_v         Jacobian [px/m] of view v; a view sees the direction e with |J_v e|
    o_v(t)      how far [px] the middle of view v's strokes lies beside the motion's picture, across it: along it is a question of time
    d(t)        doubt [m]: d^2 = largest variance of Sigma + max_v (o_v / largest |J_v e|)^2, what is open and what strokes contradict
"""

from collections.abc import Sequence

import numpy as np

from teach.curve import directions
from teach.metrics import region_radius
from teach.sketch import Sketch, ray_angle

TIMES = np.linspace(0, 1, 50)
WEAK, LEAST = 1.6, 0.004
"""A stretch is clearly the weakest where the doubt is this many times its median, and at least this [m]."""
STRAYED, STRAYED_PX = 2.0, 0.01
"""The mean strays from a view's strokes if its picture misses their mean by so many times their deviation from it, and by at
least this share of the picture's width."""
LEVEL, LEVEL_DEG = 0.3, 10.0
"""A motion is level with its cameras if more than this share of it is, to within this angle."""


def quality(drawn: Sequence[Sketch], strokes, distribution, uncertainty) -> dict:
    """drawn: the views; strokes: of each (S, T, 2) [px] at even common times; distribution: what was learned.
    uncertainty: (T, 3, 3) [m^2], Sigma at TIMES."""
    x = distribution.mean_at(TIMES)
    deviation = np.sqrt(np.einsum("tii->t", distribution.covariance_at(TIMES)).clip(0))
    off, axes = np.linalg.eigh(uncertainty)
    doubt, axis = np.sqrt(off[:, -1].clip(0)), axes[..., -1]
    angle = _ray_angles([sketch.camera for sketch in drawn], x)
    beside = np.stack([_beside(sketch.camera, points, distribution) for sketch, points in zip(drawn, strokes, strict=True)])
    weak = _weakest(drawn, x, doubt, axis, beside)
    report = {
        "deviation_mm": (1000 * deviation).round(3).tolist(),
        "uncertainty_mm": (1000 * doubt).round(3).tolist(),
        "angle_deg": angle.round(2).tolist(),
        "ray_angle_deg": float(max(ray_angle(a, b) for k, a in enumerate(drawn) for b in drawn[:k])),
        "reprojection_px": {},
        "stroke_px": {},
        "spread_px": {},
        "weakest": weak,
        "sentence": _sentence(weak),
    }
    mean = distribution.mean_at(np.linspace(0, 1, strokes[0].shape[1]))
    for sketch, points in zip(drawn, strokes, strict=True):
        miss = points - sketch.camera.project(mean)
        report["reprojection_px"][sketch.view] = float(np.linalg.norm(miss.mean(axis=0), axis=-1).mean())
        report["spread_px"][sketch.view] = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=-1).mean()))
        report["stroke_px"][sketch.view] = np.linalg.norm(miss, axis=-1).mean(axis=-1).round(2).tolist()
    return report


def _ray_angles(cameras, x) -> np.ndarray:
    """(T,) [deg]: the widest angle, up to 90, between rays of any two views to the points x (T, 3)."""
    rays = [(x - camera.centre) / np.linalg.norm(x - camera.centre, axis=1, keepdims=True) for camera in cameras]
    cosines = [np.abs((a * b).sum(axis=1)) for k, a in enumerate(rays) for b in rays[:k]]
    return np.degrees(np.arccos(np.clip(np.min(cosines, axis=0), 0, 1)))


def _beside(camera, strokes, distribution) -> np.ndarray:
    """(T,) o_v(t) [px] at TIMES. strokes: (S, T, 2) [px] of one view."""
    times = np.linspace(0, 1, strokes.shape[1])
    mean = camera.project(distribution.mean_at(times))
    tangent = directions(mean)
    off = strokes.mean(axis=0) - mean
    return np.interp(TIMES, times, np.abs(off[:, 0] * tangent[:, 1] - off[:, 1] * tangent[:, 0]))


def _weakest(drawn, x, doubt, axis, beside) -> dict:
    """The most doubtful stretch: its times, its doubt and the median one [mm], the view in which the doubt is largest in pixels, and
    whether it is clearly weaker than the rest. doubt (T,) [m] and its direction axis (T, 3) are Sigma's; beside (V, T) [px]."""
    jacobians = np.stack([sketch.camera.jacobian(x) for sketch in drawn])  # (V, T, 2, 3)
    finest = np.linalg.norm(jacobians, axis=(2, 3), ord=2)
    d = np.hypot(doubt, (beside / finest).max(axis=0))
    usual, worst = np.median(d), int(np.argmax(d))
    below = np.flatnonzero(d < (usual + d[worst]) / 2)
    first, last = max(below[below < worst], default=-1) + 1, min(below[below > worst], default=len(d)) - 1
    here = slice(first, last + 1)
    seen = np.hypot(np.linalg.norm(jacobians @ axis[:, :, None], axis=(2, 3)) * doubt, beside)[:, here].mean(axis=1)
    return {
        "from": float(TIMES[first]),
        "to": float(TIMES[last]),
        "uncertainty_mm": float(1000 * d[worst]),
        "usual_mm": float(1000 * usual),
        "view": drawn[int(np.argmax(seen))].view,
        "clear": bool(d[worst] > max(WEAK * usual, LEAST)),
    }


def _sentence(weak) -> str:
    known = f"The motion is known to about {region_radius(1) * weak['usual_mm']:.0f} mm"
    if not weak["clear"]:
        return known + " all along."
    return (f"{known} on most of its way, but only to {region_radius(1) * weak['uncertainty_mm']:.0f} mm from {weak['from']:.0%} to "
            f"{weak['to']:.0%} of it: draw that part once more on view {weak['view']}, or on a view from another side.")  # fmt: skip


def level(cameras, x) -> np.ndarray:
    """(T,) bool: where the motion x (T, 3) [m] runs in a plane with each two of the cameras, along epipolar lines of both
    views: which of their points are the same one, geometry does not say there."""
    tangent = directions(x)
    normals = [np.cross(a.centre - x, b.centre - x) for k, a in enumerate(cameras) for b in cameras[:k]]
    out = [np.abs((tangent * n).sum(axis=1)) / np.maximum(np.linalg.norm(n, axis=1), 1e-300) for n in normals]
    return np.max(out, axis=0) < np.sin(np.radians(LEVEL_DEG))


def warnings(drawn: Sequence[Sketch], x, residual, spread, angle: float, counts) -> list[str]:
    """Sentences on what was drawn that a person should know. x: (T, 3) [m], the motion; residual: reprojection_px; spread:
    spread_px; counts: of intersections."""
    sentences = []
    if (share := level([sketch.camera for sketch in drawn], x).mean()) > LEVEL:
        sentences.append(
            f"{share:.0%} of the motion runs in one plane with the cameras, so its depth rests on how evenly it was drawn; "
            "sketch on a view from higher up or lower down."
        )
    if (missing := int((counts == 0).sum())) > 0:
        sentences.append(f"At {missing} of {len(counts)} times no rays meet; the motion is interpolated there.")
    if angle < 15:
        sentences.append(
            f"The views look from nearly the same side ({angle:.0f} degrees apart), so depth is uncertain; sketch on a "
            "view from another side."
        )
    for sketch in drawn:
        outside = np.mean([1 - sketch.camera.contains(stroke.points).mean() for stroke in sketch.motions])
        if outside > 0:
            sentences.append(f"{outside:.0%} of what is drawn on view {sketch.view} lies outside the picture.")
        if (miss := residual[sketch.view]) > max(STRAYED * spread[sketch.view], STRAYED_PX * sketch.camera.width):
            sentences.append(f"The strokes on view {sketch.view} miss the motion by {miss:.0f} px; draw them again.")
        if len(sketch.motions) < 2:
            sentences.append(f"View {sketch.view} has one stroke: how far the motion may vary is a guess; draw three.")
    return sentences


def contradictions(drawn: Sequence[Sketch], agree, off) -> tuple[dict, list[str]]:
    """Views that were left out, with how far off they are [px], and a sentence on each."""
    out = {s.view: float(miss) for s, ok, miss in zip(drawn, agree, off, strict=True) if not ok}
    return out, [
        f"The sketch on view {view} contradicts the others and is left out: it misses their motion by {miss:.0f} px."
        if np.isfinite(miss)
        else f"The sketch on view {view} contradicts the others and is left out: they put the motion behind its camera."
        for view, miss in out.items()
    ]
