import numpy as np
import pytest

from conf.seen import _shows, roles
from scene.camera import Camera, look_at

CAMERA = Camera.from_fov(look_at((0, 0, 1), (1, 0, 1)), 640, 480, 60)


def test_a_picture_shows_a_motion_only_with_room_for_the_hand():
    across = lambda pixels: np.stack([np.ones(50), np.linspace(-pixels, pixels, 50) / CAMERA.K[0, 0], np.ones(50)], axis=1)
    assert _shows(CAMERA, across(250)) and not _shows(CAMERA, across(260)) and not _shows(CAMERA, across(400))
    assert not _shows(CAMERA, across(100) * [-1, 1, 1])  # behind the camera


def test_the_view_that_judges_is_one_of_those_that_are_drawn_on():
    assert roles(["view1", "view2"], "view2") == (["view1"], ["view2"]) and roles(["view1"], None) == (["view1"], [])
    with pytest.raises(ValueError, match="view3 is none of the views"):
        roles(["view1", "view2"], "view3")
