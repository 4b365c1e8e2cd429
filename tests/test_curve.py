import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from teach.curve import arc_length, deviation, extent, mean_curve, resample

curves = st.integers(1, 3).flatmap(
    lambda d: arrays(float, st.tuples(st.integers(2, 30), st.just(d)), elements=st.floats(-100, 100, width=32))
)


@given(curves, st.integers(2, 50))
def test_resampling_keeps_the_ends(curve, count):
    found = resample(curve, count)
    assert found.shape == (count, curve.shape[1])
    np.testing.assert_allclose(found[[0, -1]], curve[[0, -1]], atol=1e-6)


@given(curves, st.integers(2, 50))
def test_resampling_never_lengthens_a_curve(curve, count):
    assert arc_length(resample(curve, count))[-1] <= arc_length(curve)[-1] + 1e-6


def test_resampled_points_lie_at_equal_arc_length():
    t = np.linspace(0, 1, 5000)[:, None] ** 3  # unevenly sampled half circle
    found = resample(np.hstack([np.cos(np.pi * t), np.sin(np.pi * t), 0 * t]), 50)
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-4)
    assert arc_length(found)[-1] == pytest.approx(np.pi, rel=1e-3)


def test_a_pause_in_a_stroke_changes_nothing():
    curve = np.random.default_rng(0).normal(size=(20, 2)).cumsum(0)
    np.testing.assert_allclose(resample(np.repeat(curve, 3, axis=0), 40), resample(curve, 40))


def test_a_curve_that_does_not_move_gives_its_point():
    np.testing.assert_array_equal(resample([[3.0, 4.0]] * 5, 4), [[3.0, 4.0]] * 4)
    np.testing.assert_array_equal(resample([[3.0, 4.0]], 2), [[3.0, 4.0]] * 2)


def test_the_mean_curve_of_two_parallel_lines_lies_between_them_whatever_their_speed():
    t = np.linspace(0, 1, 30)[:, None]
    mean = mean_curve([np.hstack([t, 0 * t]), np.hstack([t**2, 0 * t + 2])], 5)
    np.testing.assert_allclose(mean, np.stack([np.linspace(0, 1, 5), np.ones(5)], axis=1), atol=1e-12)


def test_the_extent_is_the_longest_side():
    assert extent([[0, 0, 0], [1, 3, 2], [0.5, 0, -1]]) == 3


def test_the_deviation_is_that_of_points_about_their_mean_and_leaves_out_what_is_unknown():
    two = np.array([[[0.0, 0.0], [5.0, 5.0]], [[3.0, 4.0], [5.0, 5.0]]])  # 5 apart at one place, 0 at the other
    assert deviation(two) == pytest.approx(np.sqrt((5**2 / 2 + 0) / 2))
    assert deviation(np.concatenate([two, np.full((1, 2, 2), np.nan)])) == pytest.approx(deviation(two))


@pytest.mark.parametrize("curve", [np.zeros((0, 2)), [1.0, 2.0], [[0.0, np.nan], [1.0, 1.0]]])
def test_what_is_no_curve_is_refused(curve):
    with pytest.raises(ValueError, match="a curve is"):
        resample(curve, 10)
