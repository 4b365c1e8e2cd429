"""Pictures as rays, and the backdrop they were taken before."""

import numpy as np

from scene.camera import Camera, View, look_at
from scene.photographs import Photographs, backdrop, gains, ratios, spoilt


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
    rays, colours, _ = Photographs.of([one], centre, half, 1).draw(np.random.default_rng(0), 300, 0.0)
    points = (rays.origins + 1.3 * rays.directions) * half + centre
    pixels = one.camera.project(points.astype(float))
    x, y = np.floor(pixels).astype(int).T
    np.testing.assert_allclose(pixels % 1, 0.5, atol=1e-2)
    np.testing.assert_allclose(colours * 255, image[y, x], atol=1e-3)


def test_the_ratios_of_a_picture_are_medians_and_hidden_or_dark_pixels_say_nothing():
    rng = np.random.default_rng(0)
    one = view(picture())
    pixels = rng.integers(0, (80, 60), (500, 2))
    true = np.array([0.7, 1.0, 1.3])
    colour = one.image[pixels[:, 1], pixels[:, 0]] / 255 / true
    colour[:100] = rng.random((100, 3))  # something stands there that the field does not know
    np.testing.assert_allclose(np.exp(ratios(one, pixels, colour.astype(np.float32))), [true, true], rtol=1e-3)
    hidden = View("a", one.camera, one.image, np.zeros((60, 80), bool))
    np.testing.assert_array_equal(ratios(hidden, pixels, colour), 0)
    np.testing.assert_array_equal(ratios(one, pixels, np.zeros((500, 3))), 0)


def test_gains_are_what_both_halves_of_the_pictures_say():
    rng = np.random.default_rng(0)
    true = rng.normal(0, 0.2, (40, 1, 3))
    true -= true.mean(0)
    np.testing.assert_allclose(gains(np.repeat(true, 2, 1)), np.exp(true[:, 0]), rtol=1e-6)
    noisy = gains(true + rng.normal(0, 0.1, (40, 2, 3)))
    assert np.abs(np.log(noisy) - true[:, 0]).mean() < 0.07
    assert np.abs(np.log(gains(rng.normal(0, 0.3, (40, 2, 3))))).mean() < 0.05  # no exposure, only what they show
    np.testing.assert_array_equal(gains(np.zeros((3, 2, 3))), 1)


def test_pictures_much_darker_or_more_overexposed_than_the_others_are_spoilt():
    plain = picture() // 2 + 60
    plain[:20] = 255  # a white wall behind, which all of them show
    shown = [plain, plain, plain, (plain * 0.05).astype(np.uint8), np.clip(plain * 5.0, 0, 255).astype(np.uint8)]
    shown.append(np.clip(plain * 1.4, 0, 255).astype(np.uint8))
    named = [View(str(i), view(image).camera, image) for i, image in enumerate(shown)]
    assert spoilt(named) == ["3", "4"]
    assert spoilt(named[:3]) == spoilt([named[4]] * 3) == []
