"""How differently pictures are exposed, and the backdrop they were taken before."""

from dataclasses import replace

import numpy as np
import pytest

from scene import exposure
from scene.camera import Camera, View, look_at
from scene.exposure import backdrop, by_points, exposed, gains, ratios

BACKDROP = np.array([150, 155, 162])
TRUE = np.exp(np.random.default_rng(5).uniform(-0.7, 0, (8, 3)))
TRUE /= np.exp(np.log(TRUE).mean(0))


def view(image):
    height, width = image.shape[:2]
    return View("a", Camera.from_fov(look_at((2, 0.3, 1), (0, 0, 0)), width, height, 50), image)


def picture(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (60, 80, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(1).uniform(-0.4, 0.4, (150, 3))


def photographed(points, before, hidden=0.3):
    """Eight noisy pictures of points of many colours, in the middle of texture or of a plain backdrop; a share of them hidden, another each time."""
    rng, views = np.random.default_rng(2), []
    colours = rng.uniform(40, 200, (len(points), 3))
    for k in range(len(TRUE)):
        camera = Camera.from_fov(look_at((2 * np.cos(0.2 * k), 2 * np.sin(0.2 * k), 0.8), (0, 0, 0)), 320, 240, 50)
        image = rng.uniform(40, 200, (240, 320, 3)) if before is None else np.tile(before, (240, 320, 1)).astype(float)
        for (x, y), colour in zip(camera.project(points).astype(int), colours):
            colour = rng.uniform(40, 200, 3) if rng.random() < hidden else colour
            image[y - 3 : y + 4, x - 3 : x + 4] = colour
        views.append(View(f"{k}", camera, (image + rng.integers(0, 2, image.shape)).astype(np.uint8)))
    return views


def taken(views, true=TRUE):
    """The same pictures, each exposed as ``true`` says."""
    return [replace(one, image=np.clip(one.image * gain, 0, 255).astype(np.uint8)) for one, gain in zip(views, true, strict=True)]


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


def test_points_tell_exposures_even_where_some_are_hidden(points):
    np.testing.assert_allclose(by_points(taken(photographed(points, None, hidden=0)), points), TRUE, rtol=0.03)
    np.testing.assert_allclose(by_points(taken(photographed(points, None)), points), TRUE, rtol=0.08)


def test_of_many_points_some_are_asked(points, monkeypatch):
    views = taken(photographed(points, None, hidden=0))
    monkeypatch.setattr(exposure, "MOST", 60)
    np.testing.assert_array_equal(by_points(views, points), by_points(views, points[::3]))


def test_points_that_no_picture_shows_tell_nothing(points):
    np.testing.assert_array_equal(by_points(photographed(points, None), points + 100), 1)
    masked = [replace(one, mask=np.zeros(one.image.shape[:2], bool)) for one in photographed(points, None)]
    np.testing.assert_array_equal(by_points(masked, points), 1)


def test_a_backdrop_tells_exposures_to_a_level(points):
    views, few = taken(photographed(points, BACKDROP)), points[:40]
    assert np.abs(np.log(by_points(views, few) / TRUE)).max() > 0.02
    colour, found = exposed(views, few)
    np.testing.assert_allclose(found, TRUE, rtol=0.012)
    np.testing.assert_allclose(colour * 255, BACKDROP * np.exp(np.log(TRUE).mean(0)), rtol=0.012)


def test_a_picture_without_the_backdrop_goes_by_its_points(points):
    views = photographed(points, BACKDROP)
    views[3] = photographed(points, None)[3]
    colour, found = exposed(taken(views), points)
    np.testing.assert_allclose(np.delete(found, 3, 0), np.delete(TRUE, 3, 0), rtol=0.03)
    np.testing.assert_allclose(found[3], TRUE[3], rtol=0.08)
    np.testing.assert_allclose(np.exp(np.log(found).mean(0)), 1, rtol=1e-5)


def test_pictures_exposed_alike_are_left_as_they_are(points):
    colour, found = exposed(photographed(points, BACKDROP), points)
    np.testing.assert_array_equal(found, 1)
    np.testing.assert_allclose(colour * 255, BACKDROP, atol=1.01)
    colour, found = exposed(photographed(points, None), points)
    assert colour.shape == (0,) and (found == 1).all()


def test_a_backdrop_that_differs_by_a_level_or_two_says_nothing(points):
    views = photographed(points, BACKDROP)
    uneven = [replace(one, image=one.image + np.uint8(k % 4)) for k, one in enumerate(views)]
    np.testing.assert_array_equal(exposed(uneven, points)[1], 1)


def test_a_saturated_backdrop_does_not_say_how_bright_a_picture_is(points):
    brighter = TRUE / TRUE.min() * 1.3  # of all pictures the paper is white
    colour, found = exposed(taken(photographed(points, BACKDROP + 55, hidden=0), brighter), points)
    assert np.isfinite(found).all() and np.abs(np.log(found / TRUE)).max() < 0.15


def test_without_points_a_backdrop_that_pictures_have_in_common_is_found(points):
    views = photographed(points, BACKDROP)
    np.testing.assert_allclose(exposed(views)[0] * 255, BACKDROP, atol=1.01)
    np.testing.assert_array_equal(exposed(views)[1], 1)
