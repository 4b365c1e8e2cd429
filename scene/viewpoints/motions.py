"""Motions that a person may mean: any in the workspace, or those that the views drawn so far leave open.

Notation
    x(u)    (POINTS, 3) [m] at even arc length u in [0, 1]
    Phi     (POINTS, MODES): the a constant, a slope and the main modes of unit bends that belong together over LENGTH
    z       where a stroke is at even arc length [px]; d: how far along the ray through it the motion is [m]
"""

from collections.abc import Sequence

import numpy as np

from scene.camera import Camera

POINTS = 24
"""Points of a motion."""
MODES = 8
"""A constant, a slope and the main modes of bends: what a smooth curve has beyond them is below a hundredth of it."""
LENGTH = 0.25
"""How far along a motion its bends belong together, of its length."""
TRIES = 60
"""Motions drawn for each that is kept, where further strokes choose among them."""


def smooth_modes() -> np.ndarray:
    """Phi (POINTS, MODES)."""
    u = np.linspace(0, 1, POINTS)
    values, vectors = np.linalg.eigh(np.exp(-((u[:, None] - u) ** 2) / (2 * LENGTH**2)))
    bends = (vectors * np.sqrt(values.clip(0)))[:, 2 - MODES :]
    return np.column_stack([np.ones(POINTS), 2 * u - 1, bends])


def even(curve) -> np.ndarray:
    """(POINTS, D) points at even arc length of a curve (N, D)."""
    curve = np.asarray(curve, dtype=float)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    return np.stack([np.interp(np.linspace(0, along[-1], POINTS), along, x) for x in curve.T], axis=1)


def motions_in(lower, upper, count: int = 24, seed: int = 0) -> np.ndarray:
    """(count, POINTS, 3) [m]: bent motions between random places of the box between two corners (3,) [m]."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if not (upper > lower).all():
        raise ValueError(f"a workspace is a lower and a higher corner, not {lower} and {upper}")
    rng, found = np.random.default_rng(seed), []
    size, u = (upper - lower).max(), np.linspace(0, 1, POINTS)[:, None]
    bends = smooth_modes() - (1 - u) * smooth_modes()[0] - u * smooth_modes()[-1]  # both ends stay
    while len(found) < count:
        start, end = rng.uniform(lower, upper, (2, 3))
        length = np.linalg.norm(end - start)
        bend = 0.5 * length / size * (upper - lower) * (bends @ rng.normal(size=(MODES, 3)))
        motion = start + u * (end - start) + bend
        if length > 0.2 * size and ((motion >= lower) & (motion <= upper)).all():
            found.append(even(motion))
    return np.stack(found)


def left_open(cameras: Sequence[Camera], strokes, lower, upper, count: int = 24, seed: int = 0) -> np.ndarray:
    """(count, POINTS, 3) [m]: motions in a box that may be what was drawn: of each view the stroke (N, 2) [px].

    Along the first view's rays their depths are spread as the box allows, and change about as much as the motion is
    wide. Of many such motions those are kept that further views' strokes fit best.
    """
    tries = _behind(cameras[0], even(strokes[0]), lower, upper, count * (TRIES if len(cameras) > 1 else 1), seed)
    others = zip(cameras[1:], strokes[1:], strict=True)
    misses = [_miss(camera.project(tries), even(stroke)) for camera, stroke in others]
    return tries[np.argsort(np.sum(misses, axis=0), kind="stable")[:count]] if misses else tries


def _behind(camera: Camera, z, lower, upper, count: int, seed: int) -> np.ndarray:
    """(count, POINTS, 3) motions [m] that ``camera`` sees as z (POINTS, 2) [px]."""
    origins, directions = camera.rays(z)
    near, far = _through_box(origins, directions, np.asarray(lower, dtype=float), np.asarray(upper, dtype=float))
    rng, modes = np.random.default_rng(seed), smooth_modes()
    wide = np.ptp(z, axis=0).max() / camera.K[0, 0] * (near + far) / 2
    d = rng.uniform(near, far, (count, 1)) + 0.4 * wide * (rng.normal(size=(count, MODES)) @ modes.T)
    points = origins + np.clip(d, near, far)[..., None] * directions
    return np.stack([even(x) for x in points])


def _through_box(origins, directions, lower, upper) -> tuple[float, float]:
    """From where to where [m] along rays (N, 3) the box is, the median of those that hit it; where all miss it, as far as
    its ball is."""
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(lower - origins) / directions, (upper - origins) / directions]), axis=0)
    near, far = np.maximum(ends[0].max(axis=1), 1e-3), ends[1].min(axis=1)
    if (hit := far > near).any():
        return float(np.median(near[hit])), float(np.median(far[hit]))
    middle, half = np.linalg.norm((lower + upper) / 2 - origins[0]), np.linalg.norm(upper - lower) / 2
    return max(middle - half, 0.1 * middle), middle + half


def _miss(seen, z) -> np.ndarray:
    """(n,) [of z's extent]: RMS distance from curves (n, POINTS, 2) to the nearest of a stroke z (POINTS, 2), and back."""
    apart = np.linalg.norm(seen[:, :, None] - z, axis=-1)
    both = np.concatenate([apart.min(axis=1), apart.min(axis=2)], axis=1)
    return np.sqrt((np.nan_to_num(both, nan=np.inf) ** 2).mean(axis=1)) / max(np.ptp(z, axis=0).max(), 1e-9)
