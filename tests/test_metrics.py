from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from teach.metrics import coverage, dtw, frechet, mfd, region_area, region_radius, tube_at_equal_arc_length, wd

coordinates = st.floats(-10, 10, width=32)
small_curves = arrays(float, st.tuples(st.integers(1, 6), st.just(2)), elements=coordinates)
rng = np.random.default_rng(0)
CURVE = rng.normal(size=(100, 2)).cumsum(0)


def by_recursion(a, b, accumulate):
    """The definition of a coupling's cost (Eiter & Mannila 1994), cell by cell."""

    @cache
    def cost(i, j):
        d = float(np.linalg.norm(a[i] - b[j]))
        before = [cost(p, q) for p, q in ((i - 1, j), (i - 1, j - 1), (i, j - 1)) if p >= 0 and q >= 0]
        return accumulate(d, min(before)) if before else d

    return cost(len(a) - 1, len(b) - 1)


@settings(deadline=None)
@given(small_curves, small_curves)
def test_frechet_is_its_recursive_definition(a, b):
    assert frechet(a, b) == pytest.approx(by_recursion(a, b, max), abs=1e-9)


@settings(deadline=None)
@given(small_curves, small_curves)
def test_dtw_is_its_recursive_definition(a, b):
    expected = by_recursion(a, b, lambda d, best: d + best) / max(len(a), len(b))
    assert dtw(a, b) == pytest.approx(expected, abs=1e-9)


@given(small_curves, small_curves, small_curves)
def test_frechet_is_a_metric(a, b, c):
    assert frechet(a, a) == 0
    assert frechet(a, b) == frechet(b, a)
    assert frechet(a, c) <= frechet(a, b) + frechet(b, c) + 1e-9


def test_frechet_of_a_translated_curve_is_the_shift():
    t = np.linspace(0, 1, 100)[:, None]
    line = np.hstack([t, t, t])
    assert frechet(line, line + [0.3, -0.3, 0.0]) == pytest.approx(0.3 * np.sqrt(2))
    assert dtw(line, line + [0.3, -0.3, 0.0]) == pytest.approx(0.3 * np.sqrt(2))


def test_frechet_of_a_curve_drawn_backwards_is_large():
    t = np.linspace(0, 1, 100)[:, None]
    assert frechet(t, t[::-1]) == 1


def test_all_pairs_at_once_are_the_pairs_one_by_one():
    a, b = rng.normal(size=(3, 20, 2)), rng.normal(size=(4, 31, 2))
    expected = [[frechet(x, y) for y in b] for x in a]
    np.testing.assert_array_equal(frechet(a[:, None], b[None]), expected)
    assert isinstance(frechet(a[0], b[0]), float)


def test_mfd_is_mean_and_deviation_of_the_frechet_distances_over_the_width():
    strokes = [CURVE + [10, 0], CURVE + [0, 30]]
    mean, deviation = mfd(CURVE, strokes, width=640)
    assert mean == pytest.approx(20 / 640)
    assert deviation == pytest.approx(10 / 640)


def test_mfd_does_not_depend_on_drawing_speed_or_sampling():
    fine = np.stack([np.interp(np.linspace(0, 99, 991), np.arange(100), axis) for axis in CURVE.T], axis=1)
    fast_first = np.concatenate([fine[:500:20], fine[500:]])
    line = np.linspace([0, 0], [100, 50], 30)
    slow_start = line[0] + np.linspace(0, 1, 200)[:, None] ** 3 * (line[-1] - line[0])
    assert mfd(line, [slow_start], 640)[0] == pytest.approx(0, abs=1e-9)
    assert mfd(fine, [fast_first], 640)[0] < 0.005


def test_wd_of_equal_sets_is_zero_in_any_order():
    curves = [CURVE, 2 * CURVE, CURVE + 5]
    assert wd(curves, curves[::-1], 640) == pytest.approx(0, abs=1e-9)


def test_wd_of_two_single_curves_is_their_frechet_distance():
    assert wd([CURVE], [CURVE + [3, 4]], 100) == pytest.approx(0.05)


def test_wd_is_the_root_of_the_mean_square_over_the_best_assignment():
    t = np.linspace(0, 1, 100)[:, None]
    line = np.hstack([t, 0 * t])
    samples, strokes = [line, line + [0, 10]], [line + [0, 11], line + [0, 2]]
    assert wd(samples, strokes, 1) == pytest.approx(np.sqrt((2**2 + 1**2) / 2))


def test_wd_splits_mass_between_sets_of_different_size():
    t = np.linspace(0, 1, 100)[:, None]
    line = np.hstack([t, 0 * t])
    # Each of 3 strokes has 1/3, each of 2 samples 1/2: 1/3 stays at 0, 1/6 goes 0 -> 1, 1/6 stays, 1/3 goes 1 -> 2.
    found = wd([line, line + [0, 1]], [line, line + [0, 1], line + [0, 2]], 1)
    assert found == pytest.approx(np.sqrt(1 / 6 + 1 / 3))


@pytest.mark.parametrize("bad", [[np.full((5, 2), np.nan)], []])
def test_a_comparison_without_a_usable_curve_is_refused(bad):
    with pytest.raises(ValueError):
        mfd(CURVE, bad, 640)
    with pytest.raises(ValueError):
        wd(bad, [CURVE], 640)


def test_curves_of_different_dimension_are_refused():
    with pytest.raises(ValueError, match="curves to compare"):
        frechet(np.zeros((5, 2)), np.zeros((5, 3)))


def test_points_behind_the_camera_are_refused():
    with pytest.raises(ValueError, match="not finite"):
        frechet(np.full((5, 2), np.nan), np.zeros((5, 2)))


@pytest.mark.parametrize(("dimension", "radius"), [(1, 1.959964), (2, np.sqrt(-2 * np.log(0.05))), (3, 2.795483)])
def test_the_region_s_radius_is_the_chi_square_quantile_s_root(dimension, radius):
    assert region_radius(dimension) == pytest.approx(radius, rel=1e-6)


def test_the_true_region_covers_its_level():
    # Deviations across a straight tube only, so that they change no arc length: 1D normal in a 2D ellipse.
    mean = np.stack([np.linspace(0, 300, 100), np.zeros(100)], axis=1)
    covariance = np.broadcast_to(np.diag([1e-6, 9.0]), (100, 2, 2))
    curves = [mean + [0, y] for y in rng.normal(0, 3.0, 4000)]
    inside_two_dimensional_radius = 0.9857  # P(|z| <= sqrt(-2 ln 0.05))
    assert coverage(curves, mean, covariance) == pytest.approx(inside_two_dimensional_radius, abs=0.01)


def test_the_area_of_a_round_region_is_that_of_its_circle():
    mean = np.stack([np.linspace(0, 300, 50), np.zeros(50)], axis=1)
    covariance = np.broadcast_to(4.0 * np.eye(2), (50, 2, 2))
    assert region_area(mean, covariance) == pytest.approx(np.pi * 4.0 * region_radius(2) ** 2)


def test_a_tube_is_taken_at_equal_arc_length_of_its_mean():
    t = np.linspace(0, 1, 200) ** 2
    mean = np.stack([t, 0 * t], axis=1)
    covariance = t[:, None, None] * np.eye(2)
    found, spread = tube_at_equal_arc_length(mean, covariance, 11)
    np.testing.assert_allclose(found[:, 0], np.linspace(0, 1, 11), atol=1e-9)
    np.testing.assert_allclose(spread[:, 0, 0], np.linspace(0, 1, 11), atol=1e-9)
