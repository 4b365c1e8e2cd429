"""Convex parts of outlines against the winding number, which defines the silhouette."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import gaussian_filter1d

from teach.silhouette import MOST_PARTS, area, convex_parts, hull, trapezoids

SQUARE = np.array([[100, 100], [200, 100], [200, 200], [100, 200.0]])
corners = st.tuples(st.integers(3, 9), st.just(2))
polygons = arrays(float, corners, elements=st.integers(0, 2400).map(lambda eighth: eighth / 8))
lattices = arrays(float, corners, elements=st.integers(0, 6).map(lambda step: 40.0 * step))


def winding(polygon, pixels):
    """How often a closed polygon goes round pixels (N, 2): the sum of the angles under which its edges are seen."""
    seen = polygon[:, None] - pixels
    seen = seen[..., 0] + 1j * seen[..., 1]
    return np.round(np.angle(np.roll(seen, -1, axis=0) / seen).sum(axis=0) / (2 * np.pi))


def distance(polygon, pixels):
    """From the polygon's line [px], (N,)."""
    a, b = polygon[:, None], np.roll(polygon, -1, axis=0)[:, None]
    length = np.maximum(((b - a) ** 2).sum(-1), 1e-12)
    along = np.clip(((pixels - a) * (b - a)).sum(-1) / length, 0, 1)
    return np.linalg.norm(pixels - a - along[..., None] * (b - a), axis=-1).min(axis=0)


def inside(polygon, pixels):
    """In a convex, anticlockwise polygon."""
    edge, offset = np.roll(polygon, -1, axis=0) - polygon, pixels[:, None] - polygon
    height = edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0]
    return (height >= -1e-6 * np.linalg.norm(edge, axis=1)).all(axis=1)


def in_any(parts, pixels):
    return np.any([inside(part, pixels) for part in parts], axis=0) if parts else np.zeros(len(pixels), dtype=bool)


def trembling(corners, size, seed=0, count=60):
    """The closed line through corners with tremor of ``size`` [px] that changes within some ten pixels."""
    ends = zip(corners, np.roll(corners, -1, axis=0))
    line = np.concatenate([a + np.linspace(0, 1, count, endpoint=False)[:, None] * (b - a) for a, b in ends])
    tremor = gaussian_filter1d(np.random.default_rng(seed).standard_normal((len(line), 2)), 4, axis=0, mode="wrap")
    return line + size * tremor / tremor.std()


@settings(max_examples=200, deadline=None)
@given(polygons | lattices)
def test_a_pixel_is_in_a_trapezoid_where_the_outline_winds_round_it(polygon):
    pixels = np.random.default_rng(0).uniform(-10, 310, (300, 2))
    clear = distance(polygon, pixels) > 1e-3
    assert (in_any(trapezoids(polygon), pixels) == (winding(polygon, pixels) != 0))[clear].all()


@settings(max_examples=100, deadline=None)
@given(polygons | lattices)
def test_parts_hold_the_silhouette_and_nothing_more_where_nothing_may_be_filled(polygon):
    pieces = trapezoids(polygon)
    try:
        parts = convex_parts(np.vstack([polygon, polygon[:1]]))
    except ValueError as error:
        assert "encloses nothing" in str(error) and sum(map(area, pieces)) < 100
        return
    pixels = np.random.default_rng(1).uniform(-10, 310, (300, 2))
    wound, within = winding(polygon, pixels) != 0, in_any(parts, pixels)
    assert within[wound].all()
    if len(parts) < MOST_PARTS:
        assert not within[~wound & (distance(polygon, pixels) > 1.1)].any()


def test_parts_of_a_trembling_outline_are_few_and_exceed_it_little():
    outline = trembling(np.array([[50, 50], [350, 60], [340, 150], [160, 140], [150, 340], [60, 330.0]]), 1.5)
    exact, parts = trapezoids(outline), convex_parts(outline, filled=2.0)
    assert len(exact) > 100 and len(parts) <= 4
    grid = np.stack(np.meshgrid(np.arange(0, 400, 2), np.arange(0, 400, 2)), axis=-1).reshape(-1, 2) + 0.123
    wound, within = winding(outline, grid) != 0, in_any(parts, grid)
    assert within[wound].all() and within.sum() < 1.1 * wound.sum()


def test_a_convex_outline_is_one_part():
    (part,) = convex_parts(np.vstack([SQUARE, SQUARE[:1]]))
    assert 100**2 <= area(part) < 101.1**2


@pytest.mark.parametrize("more", [SQUARE[:1], SQUARE[:2], SQUARE, np.vstack([SQUARE, SQUARE[:2]])])
def test_a_loop_whose_end_runs_past_its_start_encloses_the_same(more):
    (part,) = convex_parts(np.vstack([SQUARE, more]))
    assert 100**2 <= area(part) < 101.1**2


def test_corners_that_are_hardly_in_different_rows_are_no_obstacle():
    (part,) = convex_parts([[0, 0], [100, 1e-7], [100, 50], [50, 50 - 1e-7], [0, 50], [0, 0]])
    assert 5000 <= area(part) < 101.1 * 51.1


def test_both_loops_of_an_eight_are_enclosed():
    eight = np.array([[0, 0], [100, 100], [100, 0], [0, 100.0]])
    parts = convex_parts(np.vstack([eight, eight[:1]]))
    pixels = np.array([[10, 50], [90, 50], [50, 20], [50, 80.0]])
    assert in_any(parts, pixels).tolist() == [True, True, False, False]


def test_a_comb_has_no_more_parts_than_allowed_and_loses_no_tooth():
    teeth = [[20 * k + u, v] for k in range(12) for u, v in ((0, 0), (10, 0), (10, 100), (20, 100))]
    comb = np.array([*teeth, [240, 120], [0, 120], [0, 0]], dtype=float)
    parts = convex_parts(comb)
    assert len(parts) <= MOST_PARTS
    pixels = np.random.default_rng(0).uniform(0, 240, (1000, 2))
    assert in_any(parts, pixels)[winding(comb, pixels) != 0].all()


def test_of_an_outline_with_thousands_of_corners_nothing_is_lost():
    angle = np.linspace(0, 2 * np.pi, 20000)
    star = 300 + np.stack([np.cos(angle), np.sin(angle)], axis=1) * (200 + 3 * np.sin(400 * angle))[:, None]
    parts = convex_parts(star)
    pixels = 300 + np.random.default_rng(0).uniform(-250, 250, (300, 2))
    away = np.linalg.norm(pixels - 300, axis=1)
    within = in_any(parts, pixels)
    assert within[away < 197].all() and not within[away > 212].any()
    assert in_any(parts, star[::97]).all()


@pytest.mark.parametrize(
    "outline, words",
    [
        (SQUARE[:3], "not closed: its ends are 141 px apart"),
        ([[0, 0], [100, 0], [0, 0]], "encloses nothing"),
        ([[5, 5], [6, 6], [5, 5]], "encloses nothing"),
        ([[5, 5], [5, 5]], "encloses nothing"),
        (np.random.default_rng(0).uniform(0, 500, (100, 2))[[*range(100), 0]], "crosses itself [0-9]+ times"),
    ],
)
def test_what_encloses_nothing_is_refused_in_words(outline, words):
    with pytest.raises(ValueError, match=words):
        convex_parts(outline)


@given(arrays(float, st.tuples(st.integers(3, 30), st.just(2)), elements=st.floats(-100, 100, width=16)))
def test_the_hull_is_convex_anticlockwise_and_holds_all_points(points):
    around = hull(points)
    if len(around) > 2:
        assert area(around) > 0 and inside(around, points).all()
