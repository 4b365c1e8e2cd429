import numpy as np

from teach.basis import SquaredExponential
from teach.likelihood import (
    fit_coherent,
    fit_diagonal,
    fit_mean,
    hand_prior,
    mean_uncertainty,
    moments_over_time,
    projection,
    smoothness_penalty,
)
from teach.trajectory import TrajectoryDistribution

BASIS = SquaredExponential(20, 50.0)
T = np.linspace(0, 1, 50)


def curve(t):
    return np.stack([np.sin(3 * t), t**2, 0.5 * np.cos(5 * t)], axis=-1)


def test_moments_are_the_weighted_ones_and_say_where_nothing_was_seen():
    times, points = np.array([0.0, 0.0, 1.0]), np.array([[0.0, 0, 0], [1, 0, 0], [5, 5, 5]])
    mean, variance, seen = moments_over_time(times, points, np.array([3.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0]))
    assert seen.tolist() == [True, False, True]
    assert np.allclose(mean[[0, 2]], [[0.25, 0, 0], [5, 5, 5]]) and np.allclose(variance[0], [0.1875, 0, 0])


def test_the_mean_recovers_a_smooth_curve_within_two_millimetres_and_bridges_what_was_not_seen():
    seen = np.ones(50, dtype=bool)
    assert np.abs(BASIS(T) @ fit_mean(BASIS, T, curve(T), seen, 1e-10) - curve(T)).max() < 2e-3
    seen[20:26] = False
    assert np.abs(BASIS(T) @ fit_mean(BASIS, T, curve(T), seen, 1e-9) - curve(T)).max() < 5e-3


def test_the_penalty_is_the_integral_of_squared_acceleration():
    W, t = np.random.default_rng(0).standard_normal(20), np.linspace(0, 1, 4001)[:, None] - BASIS.centres
    acceleration = ((4 * BASIS.gamma**2 * t**2 - 2 * BASIS.gamma) * np.exp(-BASIS.gamma * t**2)) @ W
    assert np.isclose(W @ smoothness_penalty(BASIS) @ W, (acceleration**2).mean(), rtol=0.03)


def test_samples_of_diagonal_weights_spread_as_fitted():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.5, 2.0, (20, 3)) * 1e-4
    variance = BASIS(T) ** 2 @ truth
    Lambda = fit_diagonal(BASIS, T, variance)
    assert np.allclose(BASIS(T) ** 2 @ Lambda, variance, rtol=0.02)
    d = TrajectoryDistribution(BASIS, np.zeros((20, 3)), np.diag(Lambda.ravel()))
    assert np.allclose(d.sample(4000, T, rng).var(axis=0), variance, rtol=0.2)


def test_diagonal_variances_maximise_the_likelihood():
    rng = np.random.default_rng(1)
    squares = rng.chisquare(3, (50, 3)) * 1e-4
    likelihood = lambda L: -(np.log(BASIS(T) ** 2 @ L) + squares / (BASIS(T) ** 2 @ L)).sum()
    best = fit_diagonal(BASIS, T, squares, 5000)
    for _ in range(20):
        assert likelihood(best * np.exp(0.1 * rng.standard_normal(best.shape))) < likelihood(best) + 1e-3


def observed(S, count, rng, noise=0.5):
    """Strokes of weights ~ N(0, S) in two views that see (x, z) and (y, z), 500 px a metre."""
    views = []
    for J in (np.array([[500.0, 0, 0], [0, 0, 500]]), np.array([[0, 500.0, 0], [0, 0, 500]])):
        H = np.concatenate([J @ np.kron(row, np.eye(3)) for row in BASIS(T)])
        w = rng.multivariate_normal(np.zeros(len(S)), S, size=count, method="svd")
        r = w @ H.T + noise * rng.standard_normal((count, len(H)))
        views.append((H, r - r.mean(axis=0)))
    return views


def test_the_coherent_covariance_of_many_strokes_is_the_true_one():
    rng = np.random.default_rng(0)
    mean = projection(BASIS, T, np.ones(50), 1e-8) @ (0.3 * curve(T))
    prior = hand_prior(BASIS, mean, 1e-8)
    A = np.kron(np.eye(20), np.diag([1.5, 0.5, 1.0]))
    truth = A @ prior @ A
    fitted = fit_coherent(observed(truth, 150, rng), prior, strength=2.0)
    variances = [TrajectoryDistribution(BASIS, mean, S).covariance_at(T) for S in (fitted, truth)]
    a, b = (np.sqrt(np.diagonal(variance, axis1=1, axis2=2)) for variance in variances)
    assert np.allclose(a, b, rtol=0.35)


def test_few_strokes_take_the_shape_of_the_prior_and_their_own_size():
    rng = np.random.default_rng(0)
    mean = projection(BASIS, T, np.ones(50), 1e-8) @ (0.3 * curve(T))
    prior = hand_prior(BASIS, mean, 1e-8)
    fitted = [fit_coherent(observed(4 * prior, 3, np.random.default_rng(k)), prior, 20.0) for k in range(20)]
    assert 3 < np.mean([np.trace(S) for S in fitted]) / np.trace(prior) < 5.5
    [(H, r), other] = observed(prior, 3, rng)
    alone = [(H, r[:1]), (other[0], other[1][:1])]  # single strokes show no spread: the prior is what there is
    assert np.array_equal(fit_coherent(alone, prior, 20.0), prior)


def test_the_hands_prior_has_its_offset_and_size():
    mean = projection(BASIS, T, np.ones(50), 1e-9) @ np.stack([0.4 * T, 0 * T, 0 * T], axis=1)
    d = TrajectoryDistribution(BASIS, mean, hand_prior(BASIS, mean, 1e-9))
    variance = np.diagonal(d.covariance_at([0.5]), axis1=1, axis2=2)[0]
    assert np.allclose(variance, (0.03**2 + 0.038**2) * 0.4**2 / 2, rtol=0.1)
    assert np.isclose(d.covariance_at([0.0])[0, 0, 0] - variance[0], (0.045 * 0.2) ** 2, rtol=0.3)


def test_the_penalty_of_a_periodic_motion_does_not_depend_on_where_it_starts():
    basis, W = BASIS.wrapped(), np.random.default_rng(0).standard_normal(20)
    t = 2 * np.pi * (np.linspace(0, 1, 4001)[:, None] - basis.centres)
    second = basis.kappa**2 * np.sin(t) ** 2 - basis.kappa * np.cos(t)
    acceleration = (2 * np.pi) ** 2 * (second * np.exp(basis.kappa * (np.cos(t) - 1))) @ W
    P = smoothness_penalty(basis)
    for k in range(20):
        assert np.isclose(np.roll(W, k) @ P @ np.roll(W, k), (acceleration**2).mean(), rtol=0.03)


def test_the_hands_prior_of_a_periodic_motion_is_the_same_all_the_way_round():
    basis, angle = BASIS.wrapped(), 2 * np.pi * T
    mean = projection(basis, T, np.ones(50), 1e-9) @ np.stack([np.cos(angle), np.sin(angle), 0 * T], axis=1)
    d = TrajectoryDistribution(basis, mean, hand_prior(basis, mean, 1e-9))
    Psi = d.features([0.0, 0.1, 0.95, 0.05])[[2, 5, 8, 11]]  # z, of which no size is part
    C = Psi @ d.covariance @ Psi.T
    assert np.allclose(np.diag(C), (0.03**2 + 0.038**2) * 2**2 / 2, rtol=0.05)
    assert np.isclose(C[0, 1], C[2, 3], rtol=0.02)  # 0.1 apart, also where the turn begins


def test_the_mean_is_the_better_known_the_more_strokes_there_are():
    mean = projection(BASIS, T, np.ones(50), 1e-8) @ (0.3 * curve(T))
    S = hand_prior(BASIS, mean, 1e-8)
    spread = lambda S: np.einsum("tii->", TrajectoryDistribution(BASIS, mean, S).covariance_at(T))
    few, many = (spread(mean_uncertainty(observed(S, n, np.random.default_rng(0)), S)) for n in (3, 300))
    assert many < 0.1 * few < 0.1 * spread(S)


def test_the_uncertainty_of_the_mean_is_the_posterior_in_closed_form():
    """With what is seen of all weights directly: ((4 S)^-1 + n (S + I)^-1)^-1 of all n strokes."""
    S = np.diag(np.linspace(1, 2, 6))
    H = np.eye(6)
    found = mean_uncertainty([(H, np.zeros((4, 6))), (H, np.zeros((2, 6)))], S)
    assert np.allclose(found, np.linalg.inv(np.linalg.inv(4 * S) + 6 * np.linalg.inv(S + np.eye(6))))
