"""The sparse pyramid: kernels and their torch twin agree, and what is kept is kept."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.field import grid as grids
from scene.field.grid import BRICK, CHANNELS, Grid


def random_grid(seed=0, sizes=(16, 52)):
    rng = np.random.default_rng(seed)
    occupied = rng.random((16, 16, 16)) < 0.3
    grid = Grid.empty()
    for size in sizes:
        grid = grid.with_level(size, occupied)
    grid.values[BRICK**3 :] = rng.normal(size=grid.values[BRICK**3 :].shape)
    return grid, occupied


def twin(grid, places):
    values, table, roots = (torch.from_numpy(a) for a in (grid.values, grid.table, grid.roots))
    return grids.interpolate(values, table, roots, grid.sizes, grid.starts, torch.from_numpy(places)).numpy()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_kernel_reads_what_its_twin_reads(seed):
    grid, _ = random_grid(seed % 7)
    places = np.random.default_rng(seed).uniform(-2, 2, (200, 3)).astype(np.float32)
    np.testing.assert_allclose(grid.look_up(places), twin(grid, places), atol=1e-4)


def test_a_linear_function_on_one_level_is_read_exactly():
    size, everywhere = 20, np.ones((4, 4, 4), bool)
    grid = Grid.empty().with_level(size, everywhere)
    corners = np.stack(np.meshgrid(*[np.arange(size + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    places = corners * 4 / size - 2
    slope = np.random.default_rng(0).normal(size=(3, CHANNELS))
    rows = [grid.rows_near(0, p[None] + 1e-6) for p in places[:1]]
    assert len(rows[0]) == 8  # a place lies among eight voxels
    # Writing through the table as `interpolate` reads it:
    root = grid.roots[np.ravel_multi_index(tuple((corners // 16).T), (size // 16 + 1,) * 3)].astype(int)
    brick = grid.table[root * 64 + grids._inner(corners // 4)].astype(int)
    grid.values[brick * 64 + grids._inner(corners)] = places @ slope
    at = np.random.default_rng(1).uniform(-2, 2, (100, 3)).astype(np.float32)
    np.testing.assert_allclose(grid.look_up(at), at @ slope, atol=1e-4)


def test_a_level_speaks_only_where_space_is_occupied():
    occupied = np.zeros((16, 16, 16), bool)
    occupied[8, 8, 8] = True
    grid = Grid.empty().with_level(256, occupied)
    grid.values[BRICK**3 :] = 1.0
    inside = np.float32([[0.1, 0.12, 0.2]])  # cell 8 spans [0, 0.25]
    outside = np.float32([[-1.0, 0.1, 0.1], [0.1, 0.5, 0.1]])
    np.testing.assert_allclose(grid.look_up(inside), 1.0, atol=1e-6)
    assert (grid.look_up(outside) == 0).all()


def test_keeping_all_occupied_bricks_changes_nothing_there_and_drops_the_rest():
    grid, occupied = random_grid()
    part = occupied.copy()
    part[8:] = False
    kept = grid.within(part)
    assert kept.bricks < grid.bricks
    cells = np.argwhere(part)
    places = (((cells + 0.5) * 4 / 16) - 2).astype(np.float32)
    np.testing.assert_array_equal(kept.look_up(places), grid.look_up(places))


def test_growing_keeps_what_was_learnt():
    grid, occupied = random_grid()
    places = np.random.default_rng(3).uniform(-2, 2, (100, 3)).astype(np.float32)
    before = grid.look_up(places)
    np.testing.assert_array_equal(grid.with_level(128, occupied).look_up(places), before)


@pytest.mark.parametrize("size", [17, 64, 100])
def test_bricks_over_everything_are_all_that_a_level_has(size):
    wanted = grids.bricks_over(np.ones((8, 8, 8), bool), size)
    assert wanted.shape == ((size // 16 + 1) ** 3, 64)
    assert wanted.sum() >= (size // 4 + 1) ** 3
