"""Which of many photographs are matched: neighbours, what looks alike, and never every pair."""

import numpy as np
import pytest

from scene.colmap.retrieval import pairs_to_match, signatures


def places(count, photographs, seed=0, noise=0.2, order=None):
    """Descriptors (50, 16) of photographs of so many places, place by place in turn (i % count)."""
    rng = np.random.default_rng(seed)
    shown = rng.normal(size=(count, 50, 16))
    return [shown[i % count] + noise * rng.normal(size=(50, 16)) for i in range(photographs)]


def joined(pairs, count):
    """Whether the pairs join all photographs."""
    group = list(range(count))
    for a, b in pairs:
        group = [group[a] if g == group[b] else g for g in group]
    return len(set(group)) == 1


def test_photographs_of_one_place_are_more_alike_than_of_others():
    s = signatures(places(4, 16), words=32)
    alike = s @ s.T
    for i in range(16):
        assert set(np.argsort(-alike[i])[:4]) == {j for j in range(16) if j % 4 == i % 4}


def test_those_that_look_alike_are_matched_however_far_apart_their_names():
    found = pairs_to_match(places(30, 120), alike=8)
    assert {(i, j) for i in range(120) for j in range(i + 30, 120, 30)} <= set(found)
    assert len(found) < 0.3 * 120 * 119 / 2


def test_neighbours_by_name_are_matched_even_without_features():
    found = pairs_to_match([np.empty((0, 16))] * 40, alike=6)
    assert {(i, i + 1) for i in range(39)} | {(i, i + 4) for i in range(36)} <= set(found)


def test_near_duplicates_are_joined_to_the_rest():
    duplicates = places(1, 100, noise=0.01) + places(20, 100, seed=1)
    assert joined(pairs_to_match(duplicates, alike=10), 200)


def test_pairs_are_sorted_unique_and_the_same_for_a_seed():
    found = pairs_to_match(places(10, 50), alike=6, seed=3)
    assert found == sorted(set(found)) and all(a < b for a, b in found)
    assert found == pairs_to_match(places(10, 50), alike=6, seed=3)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_photographs_are_matched_all_with_all(count):
    assert len(pairs_to_match(places(2, count), alike=4)) == count * (count - 1) // 2
