from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teach.sketch import Event, Stroke
from teach.turns import cuts, turns


def circle(count, start=0.0, points=300, aspect=0.6):
    """(points, 2) px: so many times round, from the phase ``start``, clockwise in the picture."""
    angle = 2 * np.pi * np.linspace(start, start + count, points)
    return np.stack([300 + 100 * np.cos(angle), 220 + 100 * aspect * np.sin(angle)], axis=1)


def zigzag(count, start=0.0, points=300):
    """(points, 2) px: so many times there and back along a line."""
    x = 2 * np.abs((np.linspace(start, start + count, points) % 1) - 0.5)
    return np.stack([150 + 300 * x, 200 + 40 * x], axis=1)


def stroke(points, noise=0.0, **others):
    trembling = noise * np.random.default_rng(0).standard_normal(points.shape)
    return Stroke(points + trembling, np.linspace(0, 3, len(points)), **others)


def by_hand(count, rng, size=1.0):
    """(400, 2) px: circles as a hand draws them, no two of the same size, place, shape or length."""
    phi = np.linspace(0, count, 400)
    kernel = np.exp(-((phi[:, None] - phi) ** 2) / (2 * 0.5**2)) + 1e-8 * np.eye(400)
    fault = size * np.linalg.cholesky(kernel) @ rng.standard_normal((400, 5))
    angle = 2 * np.pi * (phi + 0.04 * (fault[:, 0] - fault[0, 0]))
    radii = 100 * (1 + 0.06 * fault[:, 1:3]) * [1.0, rng.uniform(0.4, 1.0)]
    return 250 + 6 * fault[:, 3:] + radii * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("drawn", [circle, zigzag])
@pytest.mark.parametrize("start", [0.0, 0.1, 0.3, 0.6])
@pytest.mark.parametrize("count", [2, 3, 8])
def test_strokes_that_go_round_and_round_are_cut_once_in_every_turn(drawn, count, start):
    found = cuts(stroke(drawn(count, start, 900), noise=0.5))
    assert np.allclose(found * count, np.arange(count + 1), atol=0.04)


def test_exact_turns_are_cut_exactly():
    assert np.allclose(3 * cuts(stroke(circle(3, 0.2))), np.arange(4), atol=2e-3)


@pytest.mark.parametrize("count, whole", [(1.75, 1), (1.95, 2), (2.1, 2), (2.95, 3), (3.4, 3)])
def test_a_last_turn_counts_when_it_is_nearly_round(count, whole):
    found = turns(stroke(circle(count)))
    assert len(found) == whole
    assert all(np.linalg.norm(turn.points[-1] - turn.points[0]) < 3 for turn in found)


def spiral(count):
    u = np.linspace(0, 1, 300)[:, None]
    return 300 + u * (circle(count) - [300, 220])


def coil(count, pitch):
    return circle(count, aspect=1) + np.outer(np.linspace(0, count, 300), [200 * pitch, 0])


@pytest.mark.parametrize("drawn, numbers", [*[(circle, (n,)) for n in (0.9, 1, 1.3, 1.6)], (zigzag, (1,)),
                                            (zigzag, (1.5,)), *[(spiral, (n,)) for n in (2, 3, 6)], (coil, (2, 0.3)),
                                            (coil, (2, 0.4)), (coil, (3, 0.2)), (coil, (5, 0.2))])  # fmt: skip
def test_lines_closed_once_spirals_and_coils_do_not_go_round_and_round(drawn, numbers):
    assert len(cuts(stroke(drawn(*numbers), noise=0.5))) == 0 and turns(stroke(drawn(*numbers))) == []


@pytest.mark.parametrize("points", [[[0, 0], [9, 9]], [[0, 0], [9, 0], [0, 0]], [[0, 0], [9, 0], [9, 9], [0, 0]]])
def test_a_few_points_do_not_go_round_and_round(points):
    assert turns(stroke(np.array(points, dtype=float))) == []


def test_eights_are_turns_of_both_their_loops():
    angle = 2 * np.pi * np.linspace(0, 3, 400)
    found = cuts(stroke(np.stack([300 + 100 * np.sin(angle), 200 + 50 * np.sin(2 * angle)], axis=1), noise=0.5))
    assert np.allclose(3 * found, np.arange(4), atol=0.03)


def test_circles_drawn_by_a_hand_are_recognised_and_random_lines_are_not():
    rng = np.random.default_rng(0)
    assert sum(len(turns(stroke(by_hand(n, rng)))) == n for n in (2, 3, 4) for _ in range(10)) >= 28
    t = np.linspace(0, 1, 300)
    factor = np.linalg.cholesky(np.exp(-((t[:, None] - t) ** 2) / (2 * 0.1**2)) + 1e-8 * np.eye(300))
    lines = [250 + 100 * factor @ rng.standard_normal((300, 2)) for _ in range(50)]
    assert sum(len(cuts(stroke(line))) > 0 for line in lines) <= 1


LETTERS = Path(__file__).parents[2] / "shared" / "data" / "strokes"


@pytest.mark.skipif(not LETTERS.exists(), reason="letters drawn by a person are not here")
@pytest.mark.parametrize("letter", "CGJNSW")
def test_letters_are_not_taken_for_periodic(letter):
    from scipy.io import loadmat

    for demo in loadmat(LETTERS / f"{letter}.mat")["demos"][0]:
        points = 300 + 15 * demo["pos"][0, 0].T
        assert len(cuts(stroke(points))) == len(cuts(stroke(points, noise=1))) == 0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), count=st.floats(2, 5), start=st.floats(0, 1))
def test_joined_turns_are_the_stroke_with_the_cuts_in_it(seed, count, start):
    rng = np.random.default_rng(seed)
    drawn = Stroke(circle(count, start), np.sort(rng.uniform(0, 5, 300)), pressure=rng.uniform(0, 1, 300))
    found = turns(drawn)
    for a, b in zip(found[:-1], found[1:], strict=True):
        assert np.array_equal(a.points[-1], b.points[0]) and a.times[-1] == b.times[0]
        assert a.pressure[-1] == b.pressure[0]
    columns = lambda s: np.column_stack([s.points, s.times, s.pressure])
    joined, whole = np.concatenate([columns(turn) for turn in found]), columns(drawn)
    inside = whole[whole[:, 2] <= found[-1].times[-1]]
    assert set(map(tuple, inside)) <= set(map(tuple, joined))  # every point drawn is in a turn, as it was
    assert len(inside) >= len(joined) - 2 * len(found) - 1  # and besides them there are cuts only
    assert np.allclose([turn.length for turn in found], Stroke(circle(1), np.arange(300)).length, rtol=0.04)


def test_events_go_with_the_turn_of_their_time():
    events = tuple(Event(name, time) for name, time in [("a", 0.0), ("b", 0.5), ("c", 1.1), ("d", 2.99)])
    found = turns(stroke(circle(3.2), events=events))  # a turn lasts 0.94 s
    assert [[event.name for event in turn.events] for turn in found] == [["a", "b"], ["c"], ["d"]]
