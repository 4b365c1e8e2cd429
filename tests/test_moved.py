"""Photographs that show something else than the field learned from all."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from scene.camera import Camera, View, look_at
from scene.moved import moved

WIDTH, HEIGHT, COUNT = 320, 240, 10


@pytest.fixture(scope="module")
def views():
    """Photographs of texture of all sizes, each another."""
    rng, found = np.random.default_rng(0), []
    for k in range(COUNT):
        waves = [cv2.resize(rng.random((n * 3, n * 4, 3), np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC) for n in (2, 6, 20)]
        camera = Camera.from_fov(look_at((2, 0.1 * k, 1), (0, 0, 0)), WIDTH, HEIGHT, 50)
        found.append(View(f"{k:04d}", camera, np.clip(30 + 200 * np.mean(waves, axis=0), 0, 255).astype(np.uint8)))
    return found


class Remembered:
    """Stands for a field that learned these views perfectly, or as blurred as ``blur`` pixels."""

    def __init__(self, views, blur=0.0):
        self.blur, self.known = blur, {view.camera.centre.tobytes(): view.image for view in views}

    def render(self, camera):
        image = self.known[camera.centre.tobytes()]
        image = cv2.GaussianBlur(image, (0, 0), self.blur) if self.blur else image
        return cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.ones((camera.height, camera.width), np.float32)


def with_a_thing(view, size=40, at=(100, 150), colour=(20, 30, 200)):
    image = view.image.copy()
    image[at[0] : at[0] + size, at[1] : at[1] + size] = colour
    return replace(view, image=image)


def changed(views, k, to):
    return [to(view) if i == k else view for i, view in enumerate(views)]


def names(odd):
    return [one.view.name for one in odd]


def test_a_thing_that_one_photograph_shows_elsewhere_is_found_where_it_is(views):
    (odd,) = moved(Remembered(views), changed(views, 3, with_a_thing))
    x, y, width, height = odd.place
    assert odd.view.name == "0003" and 150 <= x + width / 2 <= 190 and 100 <= y + height / 2 <= 140
    picture = odd.picture()
    assert picture.shape == (HEIGHT, 2 * WIDTH, 3) and not np.array_equal(picture[:, :WIDTH], odd.view.image)


def test_the_oddest_photograph_comes_first(views):
    two = changed(changed(views, 3, partial(with_a_thing, colour=views[3].image[100:140, 150:190] // 3)), 7, with_a_thing)
    assert names(moved(Remembered(views), two)) == ["0007", "0003"]


def test_what_is_off_by_a_few_pixels_is_not_odd(views):
    shifted = changed(views, 3, lambda view: replace(view, image=np.roll(view.image, 3, axis=1)))
    assert names(moved(Remembered(views), shifted)) == []


def test_a_field_that_is_still_blurred_finds_no_photograph_odd(views):
    for seen in (views, changed(views, 3, with_a_thing)):
        for blur in (6, 12):
            assert names(moved(Remembered(views, blur=blur), seen)) == []


def test_a_photograph_that_is_exposed_otherwise_is_not_odd(views):
    darker = changed(views, 3, lambda view: replace(view, image=(view.image * 0.6).astype(np.uint8)))
    assert names(moved(Remembered(views), darker)) == []


def test_what_a_mask_hides_is_not_odd(views):
    hidden = np.ones((HEIGHT, WIDTH), bool)
    hidden[95:145, 145:195] = False
    masked = changed(views, 3, lambda view: replace(with_a_thing(view), mask=hidden))
    assert names(moved(Remembered(views), masked)) == []
    assert names(moved(Remembered(views), changed(masked, 3, lambda view: replace(view, mask=None)))) == ["0003"]


def test_where_the_field_shows_no_surface_nothing_is_odd(views):
    field = Remembered(views)
    nowhere = lambda camera: (Remembered.render(field, camera)[0], np.full((camera.height, camera.width), np.nan, np.float32))
    field.render = nowhere
    assert names(moved(field, changed(views, 3, with_a_thing))) == []
