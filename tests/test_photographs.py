"""Pictures as rays, and the backdrop they were taken before."""

import numpy as np

from scene.camera import Camera, View, look_at
from scene.photographs import Photographs, backdrop


def view(image):
    height, width = image.shape[:2]
    return View("a", Camera.from_fov(look_at((2, 0.3, 1), (0, 0, 0)), width, height, 50), image)


def picture(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (60, 80, 3)).astype(np.uint8)


def test_a_plain_backdrop_is_found_behind_what_stands_before_it():
    image = picture()
    image[:30] = (226, 228, 230)
    image[:30:7, ::5] += 1  # noise of a level
    np.testing.assert_allclose(backdrop([view(image)] * 3) * 255, [226, 228, 230], atol=1.5)


def test_a_textured_scene_has_none():
    assert backdrop([view(picture(k)) for k in range(3)]).shape == (0,)


def test_a_small_flat_patch_is_no_backdrop():
    image = picture()
    image[:9, :9] = 200
    assert backdrop([view(image)]).shape == (0,)


def test_a_ray_has_the_colour_of_the_pixel_it_goes_through():
    image = picture()
    one = view(image)
    centre, half = np.array([0.1, 0.2, 0.3]), 1.7
    rays, colours = Photographs.of([one], centre, half, 0.0, 1).draw(np.random.default_rng(0), 300)
    points = (rays.origins + 1.3 * rays.directions) * half + centre
    pixels = one.camera.project(points.astype(float))
    x, y = np.floor(pixels).astype(int).T
    np.testing.assert_allclose(pixels % 1, 0.5, atol=1e-2)
    np.testing.assert_allclose(colours * 255, image[y, x], atol=1e-3)
