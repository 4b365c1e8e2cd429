"""The distribution over basis weights, by Gaussian likelihood (Zhi et al. 2023, Section IV-B).

Notation
    (t_n, X_n, a_n)      points X_n [m] where rays meet at time t_n, and their weights a_n
    M (M, 3)             mean of the weights; Lambda (M, 3) their variances where they are taken as independent
    p(xi | t) = N(M^T Phi(t), Diag(Lambda^T Phi(t)^2))      eq. (9), of the independent weights of eq. (6)
    r_i = H_v d_i + e    a stroke's residual in view v [px]: d_i ~ N(0, S) its own deviation in weights, H_v the
                         camera's Jacobian times Psi(t)^T, e ~ N(0, sigma^2 I) what the basis does not express

A density p(x, y | t) of each time says nothing of how far a stroke that starts high also ends high. The strokes do:
each is one whole trajectory seen in two of three dimensions, and S is what explains them all. Its prior is a hand's: an
offset, a size and a smooth deviation, in the proportions measured on letters people drew.
"""

import numpy as np

from teach.curve import extent

OFFSET, SIZE, SMOOTH, DRIFT = 0.03, 0.045, 0.038, 0.006
"""How a person's repetitions of a drawing differ, RMS: of the motion's extent, the size of its own, the drift of the arc
length."""
SMOOTH_LENGTH, HAND_LENGTH, DRIFT_LENGTH = 0.13, 0.15, 0.1
"""Correlation lengths of the smooth deviation in normalised time, of a stroke's fault and of the drift in arc length."""
PEOPLE = 0.4
"""Strokes that what is known of people counts as: a few drawn in a row are more alike than others will be. More makes the 95 % region
of letters hold more, and samples further from strokes."""


def as_people(seen, known: float, free: int):
    """A variance seen in ``free`` independent strokes, drawn towards that known of people."""
    return (free * seen + PEOPLE * known) / (free + PEOPLE)


def correlation(u, length: float) -> np.ndarray:
    """(N, N) correlation of a smooth process at places u (N,): the squared-exponential kernel of that length."""
    return np.exp(-((u[:, None] - u) ** 2) / (2 * length**2))


def hand_correlation(u, length: float = HAND_LENGTH) -> np.ndarray:
    """(N, N) correlation of a stroke's fault at places u (N,): Matern's of order 3/2. The repetitions of people's letters have its
    spectrum; a squared exponential leaves a tenth of what they have between the 8th and the 16th wave."""
    r = np.sqrt(3) * np.abs(u[:, None] - u) / length
    return (1 + r) * np.exp(-r)


def smoothness_penalty(basis, count: int = 400, order: int = 2) -> np.ndarray:
    """(M, M) matrix P with w^T P w = integral over [0, 1] of the square of xi's derivative of that order."""
    t = np.linspace(0, 1, count)
    derivative = basis(t)
    for _ in range(order):
        derivative = np.gradient(derivative, t, axis=0)
    inside = derivative[order:-order]
    return inside.T @ inside / len(inside)


def projection(basis, t, weights, smoothness: float) -> np.ndarray:
    """(M, T) matrix that takes values at times t (T,) of weights (T,) to basis weights by penalised least squares.

    min_w  mean_t weights (Phi w - x)^2  +  smoothness integral xi''^2   (+ a ridge at the level of roundoff)
    """
    Phi = basis(t)
    share = np.asarray(weights, dtype=float) / np.sum(weights)
    A = Phi.T @ (share[:, None] * Phi) + smoothness * smoothness_penalty(basis)
    return np.linalg.solve(A + 1e-9 * np.trace(A) / len(A) * np.eye(len(A)), Phi.T * share)


def moments_over_time(times, points, weights, grid):
    """Weighted mean (T, 3) and variance (T, 3) of the points at each time of ``grid`` (T,), and which of them have any
    (T,)."""
    index = np.searchsorted(grid, times)
    mass = np.bincount(index, weights, len(grid))
    seen = mass > 0
    safe = np.where(seen, mass, 1.0)
    moment = lambda x: np.stack([np.bincount(index, weights * column, len(grid)) / safe for column in x.T], axis=1)
    mean = moment(points)
    return mean, moment((points - mean[index]) ** 2), seen


def fit_mean(basis, t, mean, seen, smoothness: float) -> np.ndarray:
    """M (M, 3) of eq. (9): least squares over the times that were seen, which the authors iterate; the penalty bridges
    the others."""
    return projection(basis, t[seen], np.ones(seen.sum()), smoothness) @ mean[seen]


def fit_diagonal(basis, t, squares, steps: int = 2000) -> np.ndarray:
    """Lambda (M, 3) >= 0 [m^2] of eq. (9), the most likely given mean squared deviations (T, 3) [m^2] from the mean at
    times t.

    Multiplicative updates of the Itakura-Saito divergence (Fevotte et al. 2009): each step raises the likelihood
    sum_t log N(squares(t); variance(t) = Lambda^T Phi(t)^2). The same Phi^2 spreads samples, so they spread as fitted.
    """
    Phi2 = basis(t) ** 2
    squares = np.maximum(squares, 1e-12 * max(squares.max(), 1e-12))
    Lambda = np.full((Phi2.shape[1], 3), squares.mean() / Phi2.sum(axis=1).mean())
    for _ in range(steps):
        variance = Phi2 @ Lambda
        Lambda = Lambda * np.sqrt((Phi2.T @ (squares / variance**2)) / (Phi2.T @ (1 / variance)))
    return Lambda


def hand_prior(basis, mean, smoothness: float, count: int = 100) -> np.ndarray:
    """(3M, 3M) covariance [m^2] of a hand's repetitions of the motion with ``mean`` (M, 3), with the size of OFFSET,
    ..."""
    t = np.linspace(0, 1, count)
    x = basis(t) @ mean
    x = x - x.mean(axis=0)
    longest = extent(x) or 1.0
    lag = t[:, None] - t
    if basis.period:  # the chord of the circle that time goes round: the end remembers the start
        lag = np.sin(np.pi * lag / basis.period) * basis.period / np.pi
    smooth = SMOOTH**2 * np.exp(-(lag**2) / (2 * SMOOTH_LENGTH**2))
    P = projection(basis, t, np.ones(count), smoothness)
    blocks = np.zeros((basis.count, 3, basis.count, 3))
    for axis in range(3):
        size = SIZE**2 * np.outer(x[:, axis], x[:, axis])
        blocks[:, axis, :, axis] = P @ ((OFFSET**2 + smooth) * longest**2 / 2 + size) @ P.T
    return blocks.reshape(3 * basis.count, -1)


def fit_coherent(observations, prior, strength: float, steps: int = 30) -> np.ndarray:
    """S (3M, 3M) [m^2] by EM, the most probable under an inverse Wishart prior worth ``strength`` strokes.

    observations: for each view H (2T, 3M) [px/m] and the residuals (n, 2T) [px] of its strokes from their mean. prior:
    (3M, 3M) [m^2], a person's, its scale drawn towards the residuals' moments first. n strokes around their own mean vary by (n - 1)
    / n only.
    """
    observations = [(H, r * np.sqrt(len(r) / (len(r) - 1))) for H, r in observations if len(r) > 1]
    if not observations:
        return prior
    count, numbers = sum(len(r) for _, r in observations), sum(r.size for _, r in observations)
    noise = _noise(observations)
    expected = sum(len(r) * np.einsum("ij,jk,ik->", H, prior, H) for H, r in observations)
    seen = sum((r**2).sum() for _, r in observations)
    size = max(seen - noise * numbers, 0.01 * seen) / expected
    S = prior = prior * as_people(size, 1.0, count - len(observations))
    for _ in range(steps):
        scatter, misfit = np.zeros_like(S), 0.0
        for H, r in observations:
            SH = S @ H.T
            gain = np.linalg.solve(H @ SH + noise * np.eye(len(H)), SH.T).T
            d = r @ gain.T  # E step: the strokes' deviations and their common uncertainty
            posterior = S - gain @ SH.T
            scatter += d.T @ d + len(r) * posterior
            misfit += ((r - d @ H.T) ** 2).sum() + len(r) * np.einsum("ij,jk,ik->", H, posterior, H)
        S = (scatter + strength * prior) / (count + strength)  # M step
        S, noise = (S + S.T) / 2, max(misfit / numbers, 0.05)
    return S


def mean_uncertainty(observations, S, vague: float = 4.0, noise: float = 1.0) -> np.ndarray:
    """(3M, 3M) [m^2]: how uncertain the mean of the weights is, after the means of n strokes in each view.

    Each view's mean stroke has the covariance (H S H^T + noise I) / n; before, the mean is N(., vague S). observations:
    as for ``fit_coherent``. noise: [px^2].
    """
    H = np.concatenate([H for H, _ in observations])
    R = np.zeros((len(H), len(H)))
    row = 0
    for block, r in observations:
        rows = slice(row, row + len(block))
        R[rows, rows] = (block @ S @ block.T + noise * np.eye(len(block))) / len(r)
        row += len(block)
    SH = vague * S @ H.T
    posterior = vague * S - SH @ np.linalg.solve(H @ SH + R, SH.T)
    return (posterior + posterior.T) / 2


def _noise(observations) -> float:
    """Variance [px^2] of the residuals outside of what the basis expresses, per number there."""
    outside, numbers = 0.0, 0.0
    for H, r in observations:
        U, values, _ = np.linalg.svd(H, full_matrices=False)
        U = U[:, values > 1e-6 * values[0]]
        outside += ((r - r @ U @ U.T) ** 2).sum()
        numbers += len(r) * (len(U) - U.shape[1])
    return max(outside / max(numbers, 1.0), 0.05)
