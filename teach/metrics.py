"""How far a predicted motion is from strokes and curves that were held out.

Notation
    F(a, b)     discrete Frechet distance of two polylines (Eiter & Mannila 1994): with d_ij = |a_i - b_j|,
                c_ij = max(d_ij, min(c_{i-1,j}, c_{i-1,j-1}, c_{i,j-1})), F = c_{n-1,m-1}
    MFD         mean over the held-out strokes of F(mean curve, stroke), over the image width
    WD          2-Wasserstein distance between samples and held-out strokes with uniform weights and ground cost F
    COUNT       points of equal arc length at which curves are compared, so that drawing speed and sampling do not count

MFD and WD are fractions of the image width: the curves are in pixels and ``width`` is the picture's [px].
"""

import numpy as np
import ot
from scipy.special import chdtri

from teach.curve import resample

COUNT = 100


def frechet(a, b):
    """Discrete Frechet distance between curves ``a`` (..., N, D) and ``b`` (..., M, D), in their unit.

    Leading dimensions broadcast: a[:, None] and b[None] give the matrix of all pairs, much faster than pair by pair.
    """
    return _cheapest_coupling(_distances(a, b), np.maximum)


def dtw(a, b):
    """Dynamic time warping between curves ``a`` (..., N, D) and ``b`` (..., M, D), in their unit.

    The smallest sum of distances over all monotone couplings (Sakoe & Chiba 1978, steps (1,0), (1,1), (0,1)), divided
    by the larger number of points: the distance of a typical pair, whatever the sampling. Leading dimensions broadcast.
    """
    distances = _distances(a, b)
    return _cheapest_coupling(distances, np.add) / max(distances.shape[-2:])


def mfd(mean, strokes, width: float) -> tuple[float, float]:
    """Mean and standard deviation over the strokes of the Frechet distance to the mean curve, over the image width.

    mean: (N, 2) px. strokes: sequence of (M_i, 2) px. The deviation is over strokes; one over seeds is the caller's.
    """
    distances = frechet(resample(mean, COUNT), _comparable(strokes)) / width
    return float(distances.mean()), float(distances.std())


def wd(samples, strokes, width: float) -> float:
    """2-Wasserstein distance between two sets of curves, over the image width: sqrt(min_P sum_ij P_ij F_ij^2).

    samples, strokes: sequences of (N_i, 2) px; P has uniform marginals (POT's emd2).
    """
    cost = frechet(_comparable(samples)[:, None], _comparable(strokes)[None]) / width
    return float(np.sqrt(max(ot.emd2([], [], cost**2), 0.0)))  # empty weights are uniform ones


def region_radius(dimension: int, level: float = 0.95) -> float:
    """Mahalanobis radius of the ellipsoid that holds ``level`` of a Gaussian in ``dimension`` dimensions."""
    return float(np.sqrt(chdtri(dimension, 1 - level)))


def coverage(curves, mean, covariance, level: float = 0.95) -> float:
    """Fraction of points of held-out curves inside the ``level`` region of a Gaussian tube, at equal arc length.

    curves: sequence of (N_i, D). mean: (T, D) and covariance: (T, D, D), the tube; it is taken at equal arc length of
    its mean, where point k of a curve at equal arc length is compared with ellipsoid k.
    """
    mean, covariance = tube_at_equal_arc_length(mean, covariance)
    deviation = _comparable(curves) - mean
    squared = np.einsum("nki,kij,nkj->nk", deviation, np.linalg.inv(covariance), deviation)
    return float((squared <= region_radius(mean.shape[1], level) ** 2).mean())


def region_area(mean, covariance, level: float = 0.95) -> float:
    """Mean area [unit^2] of the ``level`` ellipses of a tube (T, 2), (T, 2, 2), at equal arc length of its mean."""
    _, covariance = tube_at_equal_arc_length(mean, covariance)
    return float(np.pi * region_radius(2, level) ** 2 * np.sqrt(np.linalg.det(covariance)).mean())


def tube_at_equal_arc_length(mean, covariance, count: int = COUNT) -> tuple[np.ndarray, np.ndarray]:
    """A tube, mean (T, D) and covariance (T, D, D), at ``count`` points of equal arc length of the mean.

    Covariances between two given ones are interpolated linearly, so they stay positive.
    """
    mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    steps = np.linalg.norm(np.diff(mean, axis=0), axis=1)
    index = np.arange(len(mean), dtype=float)
    moves = np.concatenate([[True], steps > 0])
    s = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.interp(np.linspace(0.0, s[-1], count), s[moves], index[moves])
    below = np.minimum(at.astype(int), max(len(mean) - 2, 0))
    above, share = np.minimum(below + 1, len(mean) - 1), (at - below)[:, None]
    between = (1 - share)[..., None] * covariance[below] + share[..., None] * covariance[above]
    return (1 - share) * mean[below] + share * mean[above], between


def _comparable(curves) -> np.ndarray:
    """(n, COUNT, D): curves (N_i, D) at equal arc length."""
    if len(curves) == 0:
        raise ValueError("there is no curve to compare with: at least one stroke and one sample are needed")
    return np.stack([resample(curve, COUNT) for curve in curves])


def _distances(a, b) -> np.ndarray:
    """(..., N, M) Euclidean distances between the points of a (..., N, D) and b (..., M, D)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if a.ndim < 2 or b.ndim < 2 or a.shape[-1] != b.shape[-1] or 0 in a.shape or 0 in b.shape:
        raise ValueError(f"curves to compare are (..., N, D) and (..., M, D), not {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a curve to compare has points that are not finite; is part of it behind the camera?")
    return np.sqrt(sum((a[..., :, None, k] - b[..., None, :, k]) ** 2 for k in range(a.shape[-1])))


def _cheapest_coupling(distances, accumulate):
    """Cost of the best monotone coupling of both curves: (...,) from distances (..., N, M).

    c_ij = accumulate(d_ij, min(c_{i-1,j}, c_{i-1,j-1}, c_{i,j-1})). Cells of one anti-diagonal k = i + j do not depend
    on each other, so it is filled as a whole, for all pairs at once, indexed by i after one cell that stays infinite.
    """
    n, m = distances.shape[-2:]
    padded = np.full((*distances.shape[:-1], n + m), np.inf)
    padded[..., :m] = distances
    sheared = padded.reshape(*distances.shape[:-2], -1)[..., :-n].reshape(*distances.shape[:-1], n + m - 1)
    diagonals = np.ascontiguousarray(np.moveaxis(sheared, -1, 0))  # [k, ..., i] = d[..., i, k - i]
    before, last = (np.full((*distances.shape[:-2], n + 1), np.inf) for _ in range(2))
    last[..., 1] = diagonals[0, ..., 0]
    for d in diagonals[1:]:
        best = np.minimum(last[..., 1:], last[..., :-1])  # from (i, j-1) and (i-1, j)
        np.minimum(best, before[..., :-1], out=best)  # from (i-1, j-1)
        before, last = last, before
        accumulate(best, d, out=last[..., 1:])
    return last[..., -1][()]
