import numpy as np
import pytest

from teach.density import NOISES, Flow, GaussianTube, JointFlow, Kernels, left_out_noise, over_picture

SIZE = (320, 240)
S = np.linspace(0, 1, 60)


def strokes(offsets=(-8, 0, 8)):
    """An arc drawn three times, shifted [px]: (3, 60, 2)."""
    arc = np.stack([60 + 200 * S, 120 + 60 * np.sin(3 * S)], axis=1)
    return np.stack([arc + [0, offset] for offset in offsets])


def mass(density, t, spacing=2):
    """Integral of the density over the picture plane and a margin around it, on a grid [px]."""
    u, v = np.meshgrid(np.arange(-200, 520, spacing), np.arange(-200, 440, spacing))
    return np.exp(density.log_prob(t, np.stack([u, v], axis=-1))).sum() * spacing**2


@pytest.fixture(scope="module")
def density():
    return Flow(steps=250).fit(strokes(), SIZE, seed=0)


def test_the_density_integrates_to_one_at_every_time(density):
    for t in (0.0, 0.37, 1.0):
        assert abs(mass(density, t) - 1) < 0.02


def test_an_untrained_flow_integrates_to_one_too():
    assert abs(mass(Flow(steps=1).fit(strokes(), SIZE), 0.5) - 1) < 0.02


def test_draws_have_the_moments_of_the_noisy_strokes(density):
    t = np.array([0.1, 0.5, 0.9])
    draws = density.sample(2000, t, np.random.default_rng(0))
    truth = np.array([[np.interp(time, S, axis) for axis in strokes()[1].T] for time in t])
    noise = density.noise * np.array(SIZE)
    assert np.abs(draws.mean(axis=1) - truth).max() < 4
    assert np.allclose(draws.std(axis=1)[:, 1], np.sqrt(2 / 3 * 64 + noise[1] ** 2), rtol=0.4)


def test_the_strokes_are_likelier_than_what_lies_beside_them(density):
    beside = density.log_prob(S, strokes()[1] + [0, 60])
    assert (density.log_prob(S, strokes()[1]) > beside + 3).all()


def test_the_seed_decides_and_the_global_generator_is_left_alone():
    import torch

    torch.manual_seed(7)
    state = torch.get_rng_state()
    a, b, c = (Flow(steps=20).fit(strokes(), SIZE, seed=seed).log_prob(0.5, [[150.0, 180.0]]) for seed in (1, 1, 2))
    assert a == b and a != c
    assert torch.equal(torch.get_rng_state(), state)


def test_the_injected_noise_is_the_bandwidth_that_predicts_a_stroke_left_out():
    spread = [left_out_noise(strokes(np.array([-1, 0, 1]) * d) / np.array(SIZE)) for d in (2, 8, 24)]
    assert spread[0] < spread[1] < spread[2]
    squared = 2 * (8 / 240) ** 2  # two strokes 8 px apart: d / sqrt(2) is likeliest in the plane
    pair = strokes((0, 8)) / np.array(SIZE)
    nearest = NOISES[np.abs(np.log(NOISES / np.sqrt(squared / 4))).argmin()]
    assert left_out_noise(pair) == nearest
    assert left_out_noise(pair[:1]) == 0.01


def test_the_papers_joint_flow_integrates_to_one_over_time_and_picture():
    density = JointFlow(hidden=32, transforms=4, steps=300, noise=0.02, learning_rate=3e-3).fit(strokes(), SIZE)
    t = np.linspace(-0.5, 1.5, 81)
    assert abs(np.mean([mass(density, time, 8) for time in t]) * 2 - 1) < 0.03
    draws = density.sample(500, [0.5], np.random.default_rng(0))
    assert np.abs(draws[0].mean(axis=0) - strokes()[1][30]).max() < 25


def test_training_that_diverges_says_so():
    with pytest.raises(FloatingPointError, match="learning rate"):
        Flow(steps=30, learning_rate=1e30).fit(strokes(), SIZE)


def test_a_density_over_the_picture_integrates_to_one():
    """A Gaussian that does not move, well inside the picture."""

    class Still:
        def log_prob(self, t, points):
            return -0.5 * (((points - [100, 60]) / 12) ** 2).sum(-1) - np.log(2 * np.pi * 144)

    picture = over_picture(Still(), (200, 120), spacing=4)
    assert picture.shape == (30, 50)
    assert picture.sum() * 16 == pytest.approx(1, abs=1e-3)
    assert np.unravel_index(picture.argmax(), picture.shape) in {(14, 24), (14, 25), (15, 24), (15, 25)}


@pytest.fixture
def counted(monkeypatch):
    """The learning rate of every step of Adam."""
    import torch

    rates, step = [], torch.optim.Adam.step
    monkeypatch.setattr(
        torch.optim.Adam, "step", lambda adam: (rates.append(adam.param_groups[0]["lr"]), step(adam))[1]
    )
    return rates


def test_the_joint_flow_stops_when_the_held_out_likelihood_no_longer_rises(counted):
    # weight_decay 0 and a vanishing rate: nothing is learned, so the first look stays the best but for roundoff
    JointFlow(hidden=8, transforms=2, steps=300, learning_rate=1e-30, weight_decay=0, patience=30).fit(strokes(), SIZE)
    assert len(counted) == 40


def test_the_authors_schedule_takes_all_its_steps_at_one_rate(counted):
    JointFlow(hidden=8, transforms=2, steps=60, learning_rate=3e-4, schedule="constant").fit(strokes(), SIZE)
    assert counted == [3e-4] * 60


def test_one_cycle_rises_to_the_learning_rate_and_ends_near_zero(counted):
    JointFlow(hidden=8, transforms=2, steps=100, learning_rate=1e-2).fit(strokes(), SIZE)
    assert max(counted) == pytest.approx(1e-2, rel=0.01) and 15 <= int(np.argmax(counted)) <= 25
    assert counted[-1] < 1e-5


def test_a_schedule_that_is_not_known_is_refused():
    with pytest.raises(ValueError, match="one_cycle"):
        JointFlow(schedule="warm").fit(strokes(), SIZE)


@pytest.mark.parametrize("density", [Kernels(), GaussianTube(), Kernels(noise=0.02)], ids=["kernels", "tube", "wide kernels"])
def test_densities_without_training_integrate_to_one_and_draw_what_they_say(density):
    fitted = density.fit(strokes(), SIZE)
    for t in (0.0, 0.37, 1.0):
        assert abs(mass(fitted, t) - 1) < 0.01
    draws = fitted.sample(20_000, [0.5], np.random.default_rng(0))[0]
    truth = np.stack([np.interp(0.5, S, axis) for axis in strokes()[1].T])
    spread = np.array([0, 2 / 3 * 64]) + (fitted.noise * np.array(SIZE)) ** 2  # of strokes 8 px apart, and the kernels'
    assert np.abs(draws.mean(axis=0) - truth).max() < 0.5 and np.allclose(draws.var(axis=0), spread, rtol=0.1)


def test_kernels_tell_strokes_apart_where_a_tube_does_not():
    apart = strokes((-30, 30))
    between = strokes((0,))[0][30]
    kernels, tube = (density(noise=0.02).fit(apart, SIZE).log_prob(S[30], between) for density in (Kernels, GaussianTube))
    assert tube > kernels + 3


def test_the_tube_is_the_normal_density_in_closed_form():
    tube = GaussianTube(noise=0.01).fit(strokes(), SIZE)
    point, mean = np.array([150.0, 160.0]), tube.strokes[0, 40]
    C = tube.covariance[40]
    expected = -0.5 * (point - mean) @ np.linalg.inv(C) @ (point - mean) - 0.5 * np.log(np.linalg.det(2 * np.pi * C))
    assert np.isclose(tube.log_prob(tube.times[40], point), expected)
