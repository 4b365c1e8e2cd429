import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teach.bundle import hand_faults
from teach.curve import extent
from teach.spread import pooled

N = 100
U = np.linspace(0, 1, N)
CURVE = np.column_stack([100 + 300 * U, 200 + 80 * np.sin(5 * U)])


def drawn(sizes, rng, count=3, scale=1.0):
    """Views whose strokes stray by a hand's faults times sizes (V,), on drawings ``scale`` times as large."""
    roots = [np.linalg.cholesky(C + 1e-9 * np.trace(C) * np.eye(N)) for C in hand_faults(CURVE)]
    stray = lambda: np.stack([root @ rng.standard_normal(N) for root in roots], axis=1)
    return [scale * (CURVE + size * np.stack([stray() for _ in range(count)])) for size in sizes]


def spread(strokes) -> float:
    off = strokes - strokes.mean(axis=0)
    return float(np.sqrt((off**2).sum(-1).mean())) / extent(strokes.mean(axis=0))


def test_strokes_of_one_hand_come_to_spread_alike_in_all_views_and_their_means_stay():
    rng = np.random.default_rng(0)
    for _ in range(20):
        views = drawn(np.ones(4), rng)
        alike = pooled(views)
        for before, after in zip(views, alike, strict=True):
            np.testing.assert_allclose(after.mean(axis=0), before.mean(axis=0), atol=1e-9)
        log = lambda which: np.log([spread(strokes) for strokes in which])
        assert np.ptp(log(alike)) <= np.ptp(log(views)) + 1e-9
        assert np.ptp(log(alike)) < 0.5 * np.ptp(log(views)) or np.ptp(log(views)) > 1.0


def test_what_all_views_say_is_nearer_the_hands_spread_than_each_view_alone():
    rng, alone, together = np.random.default_rng(1), [], []
    for _ in range(40):
        views = drawn(np.ones(6), rng)
        true = np.mean([spread(strokes) for strokes in drawn([1.0], rng, count=400)])
        alone += [np.log(spread(strokes) / true) for strokes in views]
        together += [np.log(spread(strokes) / true) for strokes in pooled(views)]
    assert np.std(together) < 0.6 * np.std(alone)


def test_a_view_drawn_far_more_carefully_keeps_its_own_spread():
    views = drawn([1.0, 1.0, 0.03], np.random.default_rng(2))
    alike = pooled(views)
    assert spread(alike[2]) < 0.2 * spread(alike[0])


def test_spread_is_of_the_drawings_extent():
    rng = np.random.default_rng(3)
    near, far = drawn([1.0], rng)[0], drawn([1.0], rng, scale=0.25)[0]
    alike = pooled([near, far])
    assert spread(alike[0]) == pytest.approx(spread(alike[1]), rel=1e-6)
    assert spread(alike[0]) == pytest.approx(np.sqrt(spread(near) * spread(far)), rel=0.02)


def test_views_of_one_stroke_or_of_copies_stay_as_they_are():
    (single,), (several,) = drawn([1.0], np.random.default_rng(4), count=1), drawn([1.0], np.random.default_rng(5))
    copies = np.stack([CURVE] * 3)
    for views in ([single, single], [single, several], [copies, several, single], [copies, copies]):
        for before, after in zip(views, pooled(views), strict=True):
            np.testing.assert_allclose(after, before, atol=1e-9)


@given(seed=st.integers(0, 2**31), sizes=st.lists(st.floats(0.01, 10), min_size=2, max_size=6))
def test_order_of_views_does_not_matter_and_no_view_leaves_the_range_of_all(seed, sizes):
    views = drawn(sizes, np.random.default_rng(seed))
    alike, reverse = pooled(views), pooled(views[::-1])[::-1]
    own = [spread(strokes) for strokes in views]
    for a, b in zip(alike, reverse, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
        assert 0.999 * min(own) <= spread(a) <= 1.001 * max(own)
