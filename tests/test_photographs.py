"""Pictures as rays, and those that show nothing."""

import numpy as np

from scene.camera import Camera, View, look_at
from scene.photographs import Photographs, spoilt


def view(image):
    height, width = image.shape[:2]
    return View("a", Camera.from_fov(look_at((2, 0.3, 1), (0, 0, 0)), width, height, 50), image)


def picture(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (60, 80, 3)).astype(np.uint8)


def test_a_ray_has_the_colour_of_the_pixel_it_goes_through():
    image = picture()
    one = view(image)
    centre, half = np.array([0.1, 0.2, 0.3]), 1.7
    rays, colours, _ = Photographs.of([one], centre, half, 1).draw(np.random.default_rng(0), 300, 0.0)
    points = (rays.origins + 1.3 * rays.directions) * half + centre
    pixels = one.camera.project(points.astype(float))
    x, y = np.floor(pixels).astype(int).T
    np.testing.assert_allclose(pixels % 1, 0.5, atol=1e-2)
    np.testing.assert_allclose(colours * 255, image[y, x], atol=1e-3)


def test_pictures_much_darker_or_more_overexposed_than_the_others_are_spoilt():
    plain = picture() // 2 + 60
    plain[:20] = 255  # a white wall behind, which all of them show
    shown = [plain, plain, plain, (plain * 0.05).astype(np.uint8), np.clip(plain * 5.0, 0, 255).astype(np.uint8)]
    shown.append(np.clip(plain * 1.4, 0, 255).astype(np.uint8))
    named = [View(str(i), view(image).camera, image) for i, image in enumerate(shown)]
    assert spoilt(named) == ["3", "4"]
    assert spoilt(named[:3]) == spoilt([named[4]] * 3) == []
