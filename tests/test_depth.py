import numpy as np
import pytest

from scene.camera import Camera, look_at
from scene.field import Marched, Rays
from scene.surface.depth import confidence, passes, render

CAMERA = Camera.from_fov(look_at((0, 0, 0), (1, 0, 0)), 16, 12, 60)


class Medium:
    """A field by its optical depth: optical(t) at distance t [m] of every ray."""

    half = 2.0

    def __init__(self, optical, median):
        self.optical, self.median = optical, median

    def rays(self, origins, directions):
        return Rays(np.asarray(origins) / self.half, directions, np.zeros(len(directions)))

    def march(self, rays, far):
        through = np.exp(self.optical(rays.near * self.half) - self.optical(far * self.half))
        return Marched(None, through, None, ())

    def render(self, camera):
        _, directions = camera.rays(camera.pixel_centres())
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        return image, (self.median * (directions @ camera.forward)).astype(np.float32)


def test_in_fog_the_confidence_is_what_the_exponential_says():
    sigma = 0.8
    fog = Medium(lambda t: sigma * np.asarray(t), np.log(2) / sigma)
    for within in (0.01, 0.1, 0.5):
        _, _, sure = render(fog, CAMERA, within)
        assert sure == pytest.approx(np.full((12, 16), 2 ** -(1 - within) - 2 ** -(1 + within)), abs=1e-5)


def test_an_opaque_surface_is_certain_and_a_thick_one_less():
    surface = lambda width: Medium(lambda t: np.log(2) * np.exp(np.minimum((np.asarray(t) - 1.5) / width, 50)), 1.5)
    assert render(surface(1e-3), CAMERA)[2].min() > 0.99
    thin, thick = (render(surface(w), CAMERA)[2].mean() for w in (0.01, 0.1))
    assert 0.6 < thin < 0.99 and thick < 0.2


def test_where_nothing_is_hit_there_is_no_confidence_and_light_passes():
    nothing = Medium(lambda t: 0.1 * np.minimum(np.asarray(t), 1.0), np.nan)
    _, depth = nothing.render(CAMERA)
    assert (confidence(nothing, CAMERA, depth) == 0).all()
    assert passes(nothing, CAMERA, depth) == pytest.approx(np.full((12, 16), np.exp(-0.1)), abs=1e-6)
