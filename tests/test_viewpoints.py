"""Which views leave least of a motion open: closed forms of two cameras, brute force, and what is refused."""

from itertools import combinations

import numpy as np
import pytest

from scene import viewpoints
from scene.camera import Camera, look_at, orbit
from scene.viewpoints import Hand, coverage, expected_error, motions, propose_next, propose_pair

BOX = np.array([-0.3, -0.3, 0.2]), np.array([0.3, 0.3, 0.6])
MIDDLE = np.array([0.0, 0.0, 0.4])
EXACT_TIME = Hand(lag=0.0)


def at(azimuth_deg, elevation_deg=35.0, radius=2.0):
    return Camera.from_fov(orbit(MIDDLE, radius, elevation_deg, 1, azimuth_deg)[0], 640, 480, 45)


@pytest.fixture(scope="module")
def meant():
    return motions.motions_in(*BOX, count=12, seed=3)


def upright():
    """A straight upward motion (1, POINTS, 3), square to every level camera's axis."""
    return MIDDLE + np.linspace(-0.1, 0.1, motions.POINTS)[None, :, None] * [0, 0, 1.0]


def test_two_orthogonal_cameras_know_a_motion_as_well_as_their_hands_draw_it():
    """Far away, one view sees one side of an upright line, the other the other: the variances are those of the faults."""
    hand = Hand(offset=0.03, smooth=0.0, trembling=1e-6, lag=0.0, strokes=1)
    cameras = [Camera.from_fov(look_at(MIDDLE + np.array(a) * 100, MIDDLE), 4000, 3000, 0.3) for a in ([1, 0, 0], [0, 1, 0])]
    sideways = 0.03 * 0.2 / np.sqrt(2)  # RMS along an axis of the picture, of an extent of 0.2 m
    assert expected_error(cameras, upright(), hand) == pytest.approx(1e3 * np.sqrt(2) * sideways, rel=0.02)


def test_the_error_grows_as_one_over_the_sine_of_a_small_angle():
    errors = [expected_error([at(0, 0), at(angle, 0)], upright(), Hand(lag=0.0, offset=1e-4, size=0, smooth=0, trembling=1e-4)) for angle in (4, 8, 16)]
    assert errors[0] / errors[1] == pytest.approx(np.sin(np.radians(8)) / np.sin(np.radians(4)), rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(np.sin(np.radians(16)) / np.sin(np.radians(8)), rel=0.05)


def test_more_strokes_and_more_views_leave_less_open(meant):
    pair = [at(0), at(60)]
    assert expected_error(pair, meant, Hand(strokes=9)) < expected_error(pair, meant, Hand(strokes=3))
    assert expected_error([*pair, at(150)], meant) < expected_error(pair, meant)


def test_twice_the_scene_has_twice_the_error_and_the_same_pair(meant):
    views = [at(a, e) for a, e in ((0, 30), (35, 50), (80, 20), (140, 45))]
    larger = [Camera(c.K, np.block([[c.world_from_camera[:3, :3], 2 * c.centre[:, None]], [0, 0, 0, 1]]), 640, 480) for c in views]
    once, twice = propose_pair(views, meant), propose_pair(larger, 2 * meant)
    assert once.numbers == twice.numbers
    assert twice.error_mm == pytest.approx(2 * once.error_mm, rel=1e-6)


def test_where_time_is_not_known_a_motion_level_with_its_cameras_is_poorly_known():
    level = MIDDLE + np.linspace(-0.1, 0.1, motions.POINTS)[None, :, None] * [0.6, 0.8, 0]
    flat, steep = [at(0, 0), at(80, 0)], [at(0, 0), at(0, 80)]
    assert expected_error(flat, level, EXACT_TIME) == pytest.approx(expected_error(steep, level, EXACT_TIME), rel=0.5)
    assert expected_error(flat, level, Hand(lag=0.3)) > 1.5 * expected_error(steep, level, Hand(lag=0.3))


def test_the_proposed_pair_is_the_best_of_all(meant):
    views = [at(a, e) for a in range(0, 360, 60) for e in (25, 55)]
    proposal = propose_pair(views, meant)
    each = [viewpoints.information(view, meant) for view in views]
    score = {(a, b): np.linalg.slogdet(np.eye(len(each[0][0])) + each[a] + each[b])[1].mean() for a, b in combinations(range(len(views)), 2)}
    assert proposal.numbers == max(score, key=score.get)
    assert proposal.error_mm == pytest.approx(expected_error(proposal.cameras, meant), rel=1e-9)


def test_the_next_view_is_the_best_of_all_and_says_what_it_gains(meant):
    drawn, views = [at(0)], [at(a) for a in (5, 40, 90, 175)]
    proposal = propose_next(views, drawn, meant)
    assert proposal.error_mm == pytest.approx(min(expected_error([*drawn, view], meant) for view in views), rel=0.1)
    assert "degrees to the right of the first" in proposal.why and "instead of" in proposal.why


def test_choosing_among_too_few_views_is_refused(meant):
    with pytest.raises(ValueError, match="two views or more, not 1"):
        propose_pair([at(0)], meant)
    with pytest.raises(ValueError, match="candidates and views drawn"):
        propose_next([at(0)], [], meant)


def test_motions_stay_in_the_workspace_at_even_arc_length():
    found = motions.motions_in(*BOX, count=30, seed=1)
    assert (found >= BOX[0]).all() and (found <= BOX[1]).all()
    steps = np.linalg.norm(np.diff(found, axis=1), axis=2)
    assert (steps.max(axis=1) < 1.4 * np.median(steps, axis=1)).all()


def test_motions_that_a_stroke_leaves_open_are_seen_as_the_stroke_and_lie_at_many_depths(meant):
    camera = at(20)
    stroke = camera.project(meant[0])
    open_ = motions.left_open([camera], [stroke], *BOX, count=40)
    ends = camera.project(open_)[:, [0, -1]]
    assert np.abs(ends - stroke[[0, -1]]).max() < 1e-6
    assert np.ptp(camera.depth(open_[:, 12])) > 0.3


def test_a_second_stroke_leaves_less_open(meant):
    cameras = [at(20), at(110)]
    strokes = [camera.project(meant[0]) for camera in cameras]
    off = lambda n: np.linalg.norm(motions.left_open(cameras[:n], strokes[:n], *BOX) - meant[0], axis=2).mean()
    assert off(2) < 0.5 * off(1)


class Wall:
    """Stands for a field: an opaque wall at x = 1 that hides everything beyond."""

    def transmittance(self, origin, points):
        return np.where((origin[0] > 1.0) & (np.asarray(points)[:, 0] < 1.0), 0.0, 1.0)


class Empty:
    def transmittance(self, origin, points):
        return np.ones(len(points))


def test_a_view_on_which_the_workspace_is_hidden_is_refused(meant):
    photographed = [at(a, e) for a in range(0, 360, 20) for e in (25, 50)]
    free, hidden = (coverage.candidates(photographed, meant, field) for field in (Empty(), Wall()))
    assert any(camera.centre[0] > 1.0 for camera in free)
    assert hidden and all(camera.centre[0] <= 1.0 for camera in hidden)


def test_views_stay_where_photographs_were_taken(meant):
    photographed = [at(a, 40, radius) for a, radius in zip(range(0, 90, 10), np.linspace(1.8, 2.4, 9))]
    found = coverage.candidates(photographed, meant, Empty(), limits=coverage.Limits(farthest_deg=15))
    direction = lambda camera: (camera.centre - meant.mean((0, 1))) / np.linalg.norm(camera.centre - meant.mean((0, 1)))
    for camera in found:
        assert max(direction(camera) @ direction(photo) for photo in photographed) > np.cos(np.radians(15.1))
        assert 1.7 < np.linalg.norm(camera.centre - meant.mean((0, 1))) < 2.5
        assert camera.contains(camera.project(meant)).all()


def test_without_a_field_photographs_are_chosen_among(meant):
    photographed = [at(a) for a in range(0, 360, 40)]
    found = coverage.candidates(photographed, meant)
    assert {tuple(c.centre) for c in found} <= {tuple(c.centre) for c in photographed}


def test_a_workspace_that_nobody_photographed_is_refused():
    away = [Camera.from_fov(look_at([2, 0, 0.4], [4, a, 0.4]), 640, 480, 45) for a in (-1, 0, 1)]
    with pytest.raises(ValueError, match="no part of the workspace"):
        coverage.common_box(away, *BOX)
    with pytest.raises(ValueError, match="views 0 hold the motions"):
        coverage.candidates(away, motions.motions_in(*BOX, count=4))


def test_suggest_proposes_a_pair_then_the_view_that_a_sketch_asks_for(meant):
    photographed = [at(a, e) for a in range(0, 360, 30) for e in (25, 50)]
    pair = viewpoints.suggest(photographed, workspace=BOX, field=Empty())
    stroke = pair.cameras[0].project(meant[0])
    after = viewpoints.suggest(photographed, pair.cameras[:1], [stroke], workspace=BOX, field=Empty())
    third = viewpoints.suggest(photographed, pair.cameras, workspace=BOX, field=Empty())
    assert len(pair.cameras) == 2 and len(after.cameras) == len(third.cameras) == 1
    assert third.error_mm < pair.error_mm
    assert viewpoints.suggest(photographed).error_mm > 0  # photographs alone, around what they look at
    with pytest.raises(ValueError, match="one stroke for each view"):
        viewpoints.suggest(photographed, pair.cameras, [stroke])
