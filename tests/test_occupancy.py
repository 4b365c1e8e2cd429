"""Where the field is, which space is seen, and blocks of cells as bits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter

from scene.camera import Camera, View, look_at, orbit
from scene.field import occupancy
from scene.field.cells import dilate
from scene.field.occupancy import Occupancy


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), m=st.integers(1, 6))
def test_cells_come_back_from_their_bits(seed, m):
    occupied = np.random.default_rng(seed).random((4 * m,) * 3) < 0.2
    packed = Occupancy.of(occupied)
    assert packed.size == 4 * m
    np.testing.assert_array_equal(occupancy.cells(packed.mask), occupied)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), m=st.integers(1, 5), share=st.sampled_from([0.0, 0.01, 0.3]))
def test_bits_are_dilated_as_cells_are(seed, m, share):
    occupied = np.random.default_rng(seed).random((4 * m,) * 3) < share
    np.testing.assert_array_equal(occupancy.cells(dilate(occupancy.bits(occupied), m)), occupancy.dilated(occupied))
    np.testing.assert_array_equal(occupancy.dilated(occupied), maximum_filter(occupied, size=3, mode="constant"))


def test_cells_with_points_in_them_are_marked_beside_those_that_were():
    rng = np.random.default_rng(0)
    occupied, places = rng.random((20, 20, 20)) < 0.05, rng.uniform(-2, 2, (30, 3))
    mask = occupancy.bits(occupied)
    both = occupancy.cells(occupancy.marked(mask, places))
    np.testing.assert_array_equal(both, occupied | occupancy.around(places, 20))
    np.testing.assert_array_equal(occupancy.cells(mask), occupied)


@pytest.mark.parametrize("c, reach", [((0.1, -0.1, 0.1), 0.4), ((-0.9, 0.1, 0.1), 1.25), ((0.1, 0.1, 1.3), 2.5)])
def test_all_that_is_occupied_lies_within_its_reach(c, reach):
    occupied = occupancy.around(np.array([c]), 40)  # blocks of 0.4
    assert Occupancy.of(occupied).reach == pytest.approx(reach)
    assert Occupancy.of(np.zeros_like(occupied)).reach == 0


def test_the_distance_is_that_to_the_nearest_block_that_is_not_empty():
    rng = np.random.default_rng(0)
    occupied = rng.random((40, 40, 40)) < 2e-4
    blocks = occupied.reshape(10, 4, 10, 4, 10, 4).any(axis=(1, 3, 5))
    full, every = np.argwhere(blocks), np.argwhere(np.ones_like(blocks))
    nearest = np.abs(every[:, None] - full).max(-1).min(1)  # L-inf
    np.testing.assert_array_equal(Occupancy.of(occupied).distance, nearest)


@settings(max_examples=50, deadline=None)
@given(x=st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_contraction_has_an_inverse(x):
    np.testing.assert_allclose(occupancy.uncontract(occupancy.contract(np.array(x))), x, rtol=1e-6, atol=1e-9)


def views():
    poses = orbit((1.0, 2.0, 3.0), 2.0, 40, 8)
    return [View(str(i), Camera.from_fov(pose, 64, 48, 50), np.zeros((48, 64, 3), np.uint8)) for i, pose in enumerate(poses)]


def test_the_box_lies_where_the_cameras_look():
    centre, half = occupancy.box_of_interest(views())
    np.testing.assert_allclose(centre, [1, 2, 3], atol=1e-6)
    assert half == pytest.approx(occupancy.MARGIN * 2.0 * np.tan(np.radians(25)), rel=0.5)


def test_bounds_are_kept_and_empty_ones_refused():
    centre, half = occupancy.box_of_interest(views(), bounds=[[0, 0, 0], [2, 4, 2]])
    np.testing.assert_allclose(centre, [1, 2, 1])
    assert half == 2
    with pytest.raises(ValueError, match="bounds"):
        occupancy.box_of_interest(views(), bounds=[[1, 1, 1], [0, 0, 0]])


def test_nothing_lies_nearer_to_a_camera_than_it_is_said():
    points = np.random.default_rng(0).normal([1, 2, 3], 0.2, (500, 3))
    near = occupancy.nearest(views(), points)
    depths = np.concatenate([view.camera.depth(points) for view in views()])
    assert 0.3 < near < depths.min()
    assert occupancy.nearest(views()) == 0


def test_space_that_cameras_look_through_to_points_is_empty_and_the_points_are_not():
    colour = np.uint8([90, 90, 90])
    seen = [View(v.name, v.camera, np.full((48, 64, 3), colour)) for v in views()]
    points = np.column_stack([np.random.default_rng(1).uniform(-0.6, 0.6, (4000, 2)) + [1, 2], np.full(4000, 3.0)])
    centre, half, n = np.array([1.0, 2, 3]), 2.0, 64
    empty = occupancy.empty_by_sight(seen, points, centre, half, n)
    x, y, z = (occupancy.uncontract(occupancy.cell_centres(n)) * half + centre).T
    empty = empty.ravel()
    inside = np.hypot(x - 1, y - 2) < 0.5
    assert empty[inside & (z > 3.2) & (z < 3.5)].mean() > 0.5
    assert not empty[inside & (np.abs(z - 3) < 0.03)].any()  # the points' own cells
    assert not empty[inside & (z < 2.95)].any()  # behind the points, where nobody looks


def test_cells_that_no_picture_shows_are_not_seen():
    camera = Camera.from_fov(look_at((0, 0, 2), (0, 0, 0), up=(0, 1, 0)), 64, 48, 40)
    picture = np.zeros((48, 64, 3), np.uint8)
    seen = occupancy.seen([View("a", camera, picture), View("b", camera, picture)], np.zeros(3), 1.0, 32)
    assert seen[16, 16, 16] and not seen[0, 0, 8]
