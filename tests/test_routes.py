from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach import hand, scripted
from teach.routes import _labelings, grouped, split
from teach.sketch import Sketch, SketchError, Stroke

BOARD = np.array([0.55, 0.0, 0.45])
PERSON = hand.Hand(tremor=0.001, speed=(0.6, 0.6))
LETTERS = Path(__file__).parents[2] / "shared" / "data" / "strokes"


def two_ways(seed, order=(range(6), range(6)), person=PERSON):
    """Two views with three strokes left (0-2) and three right (3-5) of an obstacle of 8 cm, in an order of drawing."""
    for attempt in range(100):
        rng = np.random.default_rng([13, seed, attempt])
        a, target = rng.uniform(0, 2 * np.pi), BOARD + rng.normal(0, 0.05, 3)
        along, side = np.array([np.cos(a), np.sin(a), 0]), np.array([-np.sin(a), np.cos(a), 0])
        vias = [[target - 0.2 * along, target + s * 0.11 * side, target + 0.2 * along] for s in (-1, 1)]
        azimuths = rng.uniform(0, 2 * np.pi) + np.radians([0, rng.uniform(50, 100)])
        eyes = [target + [1.6 * np.cos(b), 1.6 * np.sin(b), rng.uniform(0.3, 0.9)] for b in azimuths]
        cameras = [Camera.from_fov(look_at(eye, target), 640, 480, 60) for eye in eyes]
        try:
            strokes = [sum((scripted.sketch("", c, via, person, rng)[0].strokes for via in vias), ()) for c in cameras]
        except SketchError:
            continue
        drawn = [[replace(view[k], demonstration=n) for n, k in enumerate(o)] for view, o in zip(strokes, order)]
        return [Sketch(f"v{v}", c, tuple(d)) for v, (c, d) in enumerate(zip(cameras, drawn))]
    raise AssertionError("no motion fits into its pictures")


def one_way(seed, person=PERSON, count=3):
    for attempt in range(100):
        rng = np.random.default_rng([17, seed, attempt])
        via = BOARD + 0.15 * np.cumsum(rng.normal(0, 1, (5, 3)), axis=0)
        camera = Camera.from_fov(look_at([-1.0, rng.uniform(-1, 1), 1.2], via.mean(axis=0)), 640, 480, 60)
        try:
            return scripted.sketch("v0", camera, via, person, rng, count)[0]
        except SketchError:
            continue
    raise AssertionError("no motion fits into its pictures")


@pytest.mark.parametrize("count, groups, number", [(4, 2, 7), (6, 3, 90), (3, 3, 1)])
def test_all_groupings_are_tried_once(count, groups, number):
    labelings = [tuple(labels) for labels in _labelings(count, groups)]
    assert len(labelings) == len(set(labelings)) == number  # Stirling numbers of the second kind


def test_two_ways_round_an_obstacle_are_told_apart_on_both_views():
    assert grouped(two_ways(0)) == [[[0, 1, 2], [3, 4, 5]]] * 2


def test_the_order_of_drawing_does_not_change_the_groups():
    drawn = two_ways(0, ([0, 3, 1, 4, 2, 5], [5, 0, 4, 1, 3, 2]))
    assert grouped(drawn) == [[[0, 2, 4], [1, 3, 5]], [[0, 2, 4], [1, 3, 5]]]


def test_ways_drawn_in_opposite_order_on_two_views_are_matched_by_where_they_meet():
    straight, crossed = two_ways(0), two_ways(0, (range(6), [3, 4, 5, 0, 1, 2]))
    ways, notes = split(crossed)
    assert notes == [] and len(ways) == 2
    same = {tuple(stroke.points[0, 0] for sketch in way for stroke in sketch.motions) for way in split(straight)[0]}
    assert same == {tuple(stroke.points[0, 0] for sketch in way for stroke in sketch.motions) for way in ways}


def test_where_views_cannot_tell_the_order_is_taken_and_said_unless_demonstrations_are_numbered(monkeypatch):
    monkeypatch.setattr("teach.routes.SURE", 1e9)
    crossed = two_ways(0, (range(6), [3, 4, 5, 0, 1, 2]))
    ways, notes = split(crossed)
    assert "order of drawing was taken" in notes[0]
    assert ways[0][1].motions == crossed[1].strokes[:3]
    numbers = ([1, 1, 1, 2, 2, 2], [2, 2, 2, 1, 1, 1])
    numbered = [
        replace(sketch, strokes=tuple(replace(stroke, demonstration=n) for stroke, n in zip(sketch.strokes, view)))
        for sketch, view in zip(crossed, numbers)
    ]
    ways, notes = split(numbered)
    assert notes == [] and ways[0][1].motions == numbered[1].strokes[3:]


@pytest.mark.parametrize("person", [PERSON, hand.scaled(PERSON, 2)])
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_repetitions_of_one_way_are_one_route(person, count):
    assert all(len(grouped([one_way(seed, person, count)])[0]) == 1 for seed in range(5))


def test_clustering_finds_the_groups_that_trying_all_finds(monkeypatch):
    drawn = two_ways(0)
    monkeypatch.setattr("teach.routes.ENUMERATED", 0)
    assert grouped(drawn) == [[[0, 1, 2], [3, 4, 5]]] * 2


def test_a_single_stroke_that_goes_astray_on_one_view_is_left_out_and_said(monkeypatch):
    monkeypatch.setattr("teach.routes.grouped", lambda _: [[[0, 1, 2], [3]], [[0, 1, 2, 3, 4, 5]]])
    drawn = two_ways(0)
    (way,), notes = split([replace(drawn[0], strokes=drawn[0].strokes[:4]), drawn[1]])
    assert way[0].motions == drawn[0].strokes[:3] and len(way[1].motions) == 6
    assert "Stroke 4 on view v0 goes another way" in notes[0]


@pytest.mark.slow
def test_two_ways_are_found_over_20_seeds():
    assert sum(max(map(len, grouped(two_ways(seed)))) == 2 for seed in range(20)) >= 19


@pytest.mark.slow
@pytest.mark.skipif(not LETTERS.exists(), reason="letters drawn by a person are not here")
@pytest.mark.parametrize("letter", "CGJNSW")
def test_any_three_strokes_of_a_persons_letter_are_one_route(letter):
    from itertools import combinations

    from scipy.io import loadmat

    flat = [demo["pos"][0, 0].T * 0.30 / 18 for demo in loadmat(LETTERS / f"{letter}.mat")["demos"][0][:9]]
    camera = Camera([[550, 0, 320], [0, 550, 240], [0, 0, 1]], look_at((-0.25, -0.75, 0.75), BOARD), 640, 480)
    paths = [camera.project(BOARD + np.column_stack([0 * x[:, 0], -x[:, 0], x[:, 1]])) for x in flat]
    strokes = [Stroke(x, np.linspace(0, 2, len(x))) for x in paths]
    assert all(len(grouped([Sketch("v0", camera, three)])[0]) == 1 for three in combinations(strokes, 3))
