"""Curves as polylines (N, D): arc length, equal spacing, deviation, extent. Any dimension, any unit.

    s_i = sum_{j < i} |x_{j+1} - x_j|       arc length up to point i
"""

import numpy as np


def arc_length(points) -> np.ndarray:
    """Length of the polyline ``points`` (N, D) up to each of its points: (N,), from 0, in the unit of the points."""
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or len(points) == 0 or not np.isfinite(points).all():
        raise ValueError(f"a curve is (N, D) finite numbers with N at least 1, not an array {points.shape}")
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def resample(points, count: int) -> np.ndarray:
    """``count`` points (count, D) at equal arc length along the polyline ``points`` (N, D); the ends are kept.

    A curve that does not move gives its point ``count`` times.
    """
    points, s = np.asarray(points, dtype=float), arc_length(points)
    moves = np.concatenate([[True], np.diff(s) > 0])  # a repeated point would make the inverse of s ambiguous
    at = np.linspace(0.0, s[-1], count)
    return np.stack([np.interp(at, s[moves], column[moves]) for column in points.T], axis=1)


def directions(points) -> np.ndarray:
    """(N, D) way of the polyline ``points`` (N, D) at each of them, of length 1; 0 where it does not move."""
    step = np.gradient(np.asarray(points, dtype=float), axis=0)
    return step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-300)


def mean_curve(curves, count: int = 200) -> np.ndarray:
    """(count, D) mean of curves (N_i, D), each at equal arc length; the result again at equal arc length."""
    return resample(np.mean([resample(curve, count) for curve in curves], axis=0), count)


def deviation(curves) -> float:
    """RMS distance of curves (n, T, D), n at least 2, from their mean, place by place, over n - 1; places that are nan are left out."""
    return float(np.sqrt(np.nanvar(curves, axis=0, ddof=1).sum(axis=1).mean()))


def extent(points) -> float:
    """Longest side of the bounding box along the axes of points (N, D): how large a motion or a drawing is."""
    return float(np.ptp(np.asarray(points, dtype=float), axis=0).max())
