import numpy as np
import pytest

from teach.basis import SquaredExponential


def test_each_function_is_one_at_its_own_centre_and_falls_off_as_the_paper_writes():
    basis = SquaredExponential(count=5, gamma=50)
    assert np.allclose(np.diag(basis(basis.centres)), 1)
    assert np.isclose(basis(0.1)[0, 0], np.exp(-50 * 0.1**2))
    assert np.allclose(basis.centres, [0, 0.25, 0.5, 0.75, 1])


def test_features_have_one_row_per_time():
    assert SquaredExponential()(np.linspace(0, 1, 7)).shape == (7, 20)
    assert SquaredExponential()(0.5).shape == (1, 20)


@pytest.mark.parametrize("count, gamma", [(1, 50), (20, 0), (20, -1), (20, np.nan)])
def test_a_basis_without_functions_or_width_is_refused(count, gamma):
    with pytest.raises(ValueError, match="gamma > 0"):
        SquaredExponential(count, gamma)
