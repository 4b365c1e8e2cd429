import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teach.basis import Periodic, SquaredExponential


def test_each_function_is_one_at_its_own_centre_and_falls_off_as_the_paper_writes():
    basis = SquaredExponential(count=5, gamma=50)
    assert np.allclose(np.diag(basis(basis.centres)), 1)
    assert np.isclose(basis(0.1)[0, 0], np.exp(-50 * 0.1**2))
    assert np.allclose(basis.centres, [0, 0.25, 0.5, 0.75, 1])


@pytest.mark.parametrize("basis", [SquaredExponential(), Periodic()])
def test_features_have_one_row_per_time(basis):
    assert basis(np.linspace(0, 1, 7)).shape == (7, basis.count)
    assert basis(0.5).shape == (1, basis.count)


@pytest.mark.parametrize("count, gamma", [(1, 50), (20, 0), (20, -1), (20, np.nan)])
def test_a_basis_without_functions_or_width_is_refused(count, gamma):
    with pytest.raises(ValueError, match="gamma > 0"):
        SquaredExponential(count, gamma)


@given(t=st.floats(-3, 3), turns=st.integers(-3, 3), count=st.integers(2, 30), kappa=st.floats(0.1, 50))
def test_a_periodic_basis_has_period_one(t, turns, count, kappa):
    assert np.allclose(Periodic(count, kappa)(t + turns), Periodic(count, kappa)(t), atol=1e-10)


def test_periodic_functions_are_one_at_their_centres_and_the_same_but_for_their_place():
    basis = Periodic(count=5, kappa=3)
    assert np.allclose(np.diag(basis(basis.centres)), 1)
    assert np.allclose(basis.centres, [0, 0.2, 0.4, 0.6, 0.8])
    assert np.isclose(basis(0.1)[0, 0], np.exp(3 * (np.cos(0.2 * np.pi) - 1)))
    assert np.allclose(basis(0.7 + basis.centres), np.stack([np.roll(basis(0.7)[0], k) for k in range(5)]))


def test_wrapped_functions_are_as_wide_as_they_were():
    basis, t = SquaredExponential(20, 50), 0.5 + np.linspace(-0.05, 0.05, 11)
    bump = basis.wrapped()(t)[:, 10]
    assert np.allclose(bump, np.exp(-50 * (t - 0.5) ** 2), atol=2e-3)
    assert (basis.period, basis.wrapped().period, basis.wrapped().count) == (None, 1.0, 20)


@pytest.mark.parametrize("count, kappa", [(1, 2.5), (20, 0), (20, -1), (20, np.nan)])
def test_a_periodic_basis_without_functions_or_width_is_refused(count, kappa):
    with pytest.raises(ValueError, match="kappa > 0"):
        Periodic(count, kappa)
