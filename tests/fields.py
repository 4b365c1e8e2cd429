"""Fields without a scene: random voxels in random cells, as the kernels and their twin are compared on; a sheet in front of each camera."""

import numpy as np

from scene.field import Field, Marched, Rays, Shading
from scene.field.grid import BRICK, Grid
from scene.field.kernels import WEIGHT
from scene.field.occupancy import Occupancy


def random_field(share: float) -> Field:
    """Voxels of two levels in this share of 16^3 cells, before a plain background."""
    rng = np.random.default_rng(0)
    occupied = rng.random((16, 16, 16)) < share
    grid = Grid.empty().with_level(16, occupied).with_level(48, occupied)
    grid.values[BRICK**3 :, :WEIGHT] = rng.normal(0, 0.7, (len(grid.values) - BRICK**3, WEIGHT))
    shading = Shading(np.float32([0.2, 0.5, 0.9]), *(rng.normal(0, 0.3, s).astype(np.float32) for s in ((15, 12), (12, 3))))
    return Field(np.zeros(3), 1.0, grid, shading, Occupancy.of(occupied), step=0.05, scale=4.0, shift=-1.0, near=0.02)


class Painter:
    """Stands for a field: a sheet 2.5 m in front of each camera, painted in ``colours`` in turn; where the camera sees it on
    the right, ``passes`` of the light passes it (0: all is sure there, 1: nothing). Remembers what it painted; is killed
    after ``lives`` pictures."""

    half = 1.0

    def __init__(self, lives=99, colours=(7,), passes=0.0):
        self.lives, self.colours, self.passes, self.painted, self.limits = lives, colours, passes, [], None

    def render(self, camera, **limits):
        if not self.lives:
            raise KeyboardInterrupt
        self.lives -= 1
        colour, size = self.colours[len(self.painted) % len(self.colours)], (camera.height, camera.width)
        self.painted.append(camera)
        self.limits = limits
        return np.full((*size, 3), colour, np.uint8), np.full(size, 2.5, np.float32)

    def rays(self, origins, directions):
        return Rays(origins, directions, np.zeros(len(directions), np.float32))

    def march(self, rays, far):
        right = rays.directions @ self.painted[-1].world_from_camera[:3, 0] > 0
        return Marched(None, np.where(right, self.passes, 0.0), None, ())
