import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from scene.frame.triangulation import triangulate


def cameras(count=8):
    angles = np.linspace(0, 5, count)
    eyes = [(0.6 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0.9 + 0.1 * np.sin(3 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.6, 0, 0)), 640, 480, 50) for eye in eyes]


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_exact_pixels_return_their_point(offset):
    true = np.array([0.6, 0.0, 0.0]) + offset
    point, agree = triangulate([camera.project(true) for camera in cameras()], cameras())
    assert np.allclose(point, true, atol=1e-9) and agree.all()


def test_three_wrong_views_of_eight_do_no_harm():
    true = np.array([0.5, 0.1, 0.05])
    pixels = np.array([camera.project(true) for camera in cameras()])
    pixels[[1, 4, 6]] += [[30, -10], [-4, 60], [5, 5]]
    point, agree = triangulate(pixels, cameras())
    assert np.allclose(point, true, atol=1e-9)
    assert agree.tolist() == [True, False, True, True, False, True, False, True]


def test_one_view_gives_no_point():
    point, agree = triangulate([[100.0, 100.0]], cameras()[:1])
    assert np.isnan(point).all() and not agree.any()
