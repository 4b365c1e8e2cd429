"""A field without a scene: random voxels in random cells, as the kernels and their twin are compared on."""

import numpy as np

from scene.field import Field, Shading
from scene.field.grid import BRICK, Grid
from scene.field.occupancy import Occupancy


def random_field(share: float) -> Field:
    """Voxels of two levels in this share of 16^3 cells, before a plain background."""
    rng = np.random.default_rng(0)
    occupied = rng.random((16, 16, 16)) < share
    grid = Grid.empty().with_level(16, occupied).with_level(48, occupied)
    grid.values[BRICK**3 :] = rng.normal(0, 0.7, grid.values[BRICK**3 :].shape)
    shading = Shading(np.float32([0.2, 0.5, 0.9]), *(rng.normal(0, 0.3, s).astype(np.float32) for s in ((16, 12), (12, 3))))
    return Field(np.zeros(3), 1.0, grid, shading, Occupancy.of(occupied), step=0.05, scale=4.0, shift=-1.0, near=0.02)
