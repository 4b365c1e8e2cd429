import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.baselines import linear, nearest_neighbour, pose_distance
from teach.metrics import mfd
from teach.sketch import Sketch, Stroke


def camera(eye, width=640, height=480):
    return Camera.from_fov(look_at(eye, [0.5, 0, 0.4]), width, height, 60)


def sketch(name, camera, *lines):
    return Sketch(name, camera, tuple(Stroke(np.array(line, float), np.arange(len(line))) for line in lines))


def test_linear_joins_the_mean_start_and_the_mean_end():
    line = linear([[[0, 0], [50, 90], [100, 0]], [[0, 20], [30, 30], [100, 40], [120, 40]]], 3)
    np.testing.assert_allclose(line, [[0, 10], [55, 15], [110, 20]])


def test_linear_is_exact_for_a_straight_motion():
    straight = np.linspace([10, 20], [300, 200], 50)
    assert mfd(linear([straight]), [straight], 640)[0] == pytest.approx(0, abs=1e-12)


def test_nearest_neighbour_takes_the_strokes_of_the_nearest_camera_unchanged():
    near = sketch("near", camera([-0.5, 0.4, 1]), [[0, 0], [10, 0], [10, 10]], [[1, 1], [3, 5]])
    far = sketch("far", camera([0.5, -1.5, 1]), [[9, 9], [0, 0]])
    found = nearest_neighbour([far, near], camera([-0.6, 0.2, 0.9]), 3)
    np.testing.assert_allclose(found, [[[0, 0], [10, 0], [10, 10]], [[1, 1], [2, 3], [3, 5]]])


def test_nearest_neighbour_scales_with_the_picture():
    drawn = sketch("a", camera([-1, 0, 1]), [[64, 48], [640, 480]])
    found = nearest_neighbour([drawn], camera([-1, 0, 1], 320, 120), 2)
    np.testing.assert_allclose(found, [[[32, 12], [320, 120]]])


def test_nearest_neighbour_ignores_keep_out_regions():
    region = Stroke(np.array([[0, 0], [1, 1.0]]), np.array([0, 1.0]), kind="keep_out")
    motion = Stroke(np.array([[5, 5], [6, 6.0]]), np.array([0, 1.0]))
    drawn = Sketch("a", camera([-1, 0, 1]), (region, motion))
    assert nearest_neighbour([drawn], drawn.camera).shape == (1, 100, 2)


def test_pose_distance_is_the_angle_of_the_rotation_and_the_distance():
    a, b = camera([-0.5, 0, 0.4]), camera([0.5, -2, 0.4])
    angle, distance = pose_distance(a, b)
    assert angle == 90
    assert distance == pytest.approx(np.sqrt(5))
    assert pose_distance(a, a) == (0, 0)


def test_among_cameras_turned_alike_the_closer_one_is_nearest():
    pose = camera([-1, 0, 1])
    drawn = []
    for i, y in enumerate((0.5, 0.2)):
        shift = np.eye(4)
        shift[1, 3] = y
        drawn.append(sketch(str(i), pose.moved(shift), [[i, 0], [i, 10]]))
    assert nearest_neighbour(drawn, pose)[0, 0, 0] == 1
