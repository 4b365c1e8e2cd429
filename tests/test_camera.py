import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scene.camera import OPENCV_FROM_OPENGL, Camera, View, invert, look_at, nearest_to_rays, orbit, ray_distance

coordinate = st.floats(-2, 2).map(lambda v: round(v, 6))
position = st.tuples(coordinate, coordinate, coordinate).map(np.array)


@st.composite
def poses(draw):
    eye, target = draw(position), draw(position)
    assume(np.linalg.norm(eye - target) > 0.1)
    return look_at(eye, target, up=draw(st.sampled_from([(0, 0, 1), (0, 1, 0), (1, 1, 1)])))


@st.composite
def similarities(draw):
    matrix = draw(poses()).copy()
    matrix[:3, :3] *= draw(st.floats(0.1, 10))
    return matrix


@st.composite
def lenses(draw):
    width, height = draw(st.integers(10, 4000)), draw(st.integers(10, 4000))
    fx = draw(st.floats(0.4, 3)) * width
    fy, cx, cy = fx * draw(st.floats(0.8, 1.2)), width * draw(st.floats(0.3, 0.7)), height * draw(st.floats(0.3, 0.7))
    return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), draw(poses()), width, height)


@given(lenses(), st.floats(0, 1), st.floats(0, 1), st.floats(0.05, 100))
def test_a_projected_ray_returns_its_pixel(camera, u, v, distance):
    pixel = np.array([u * camera.width, v * camera.height])
    origin, direction = camera.rays(pixel)
    assert np.allclose(camera.project(origin + distance * direction), pixel, atol=1e-6 * camera.width)
    assert np.linalg.norm(direction) == pytest.approx(1)


@given(lenses(), position)
def test_the_ray_of_a_projected_point_passes_through_it(camera, point):
    assume(camera.depth(point) > 1e-3)
    origin, direction = camera.rays(camera.project(point))
    to_point = point - origin
    obliqueness = np.linalg.norm(to_point) / camera.depth(point)
    assert np.linalg.norm(to_point - direction * (direction @ to_point)) < 1e-7 * (1 + obliqueness)
    assert direction @ to_point > 0


def test_the_corner_of_the_picture_is_pixel_zero_and_centres_lie_at_one_half():
    camera = Camera.from_fov(np.eye(4), 4, 2, 90)
    assert np.allclose(camera.K, [[2, 0, 2], [0, 2, 1], [0, 0, 1]])
    assert np.allclose(camera.project([-1, -0.5, 1]), [0, 0])
    assert np.allclose(camera.pixel_centres()[0, 0], [0.5, 0.5]) and camera.pixel_centres().shape == (2, 4, 2)
    assert camera.contains([[0, 0], [4, 2], [4.01, 1], [np.nan, 1]]).tolist() == [True, True, False, False]


def test_points_behind_the_camera_have_no_pixel():
    camera = Camera.from_fov(np.eye(4), 4, 2, 90)
    assert np.isnan(camera.project([[0, 0, -1], [1, 1, 0]])).all()
    assert camera.depth([[3, 4, -1], [0, 0, 2]]).tolist() == [-1, 2]


def test_opencv_axes_are_x_right_y_down_z_forward():
    camera = Camera.from_fov(look_at((0, -2, 0), (0, 0, 0)), 100, 100, 60)
    right, high = camera.project([0.1, 0, 0]), camera.project([0, 0, 0.1])
    assert right[0] > 50 and right[1] == pytest.approx(50)
    assert high[1] < 50 and high[0] == pytest.approx(50)
    assert np.allclose(camera.forward, [0, 1, 0]) and np.allclose(camera.centre, [0, -2, 0])


def test_opengl_axes_are_x_right_y_up_z_backward():
    opengl = look_at((0, -2, 0), (0, 0, 0)) @ OPENCV_FROM_OPENGL
    assert np.allclose(opengl[:3, :3].T, [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert np.allclose(OPENCV_FROM_OPENGL @ OPENCV_FROM_OPENGL, np.eye(4))


@given(position, position, st.sampled_from([(0, 0, 1), (0, 1, 0), (1, 0, 0)]))
def test_look_at_puts_the_target_in_the_middle(eye, target, up):
    assume(np.linalg.norm(eye - target) > 1e-3)
    pose = look_at(eye, target, up)
    assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3)) and np.linalg.det(pose) == pytest.approx(1)
    camera = Camera.from_fov(pose, 64, 48, 50)
    assert np.allclose(camera.project(target), [32, 24], atol=1e-4)
    assert camera.depth(target) == pytest.approx(np.linalg.norm(eye - target))


def test_looking_along_up_still_gives_a_pose():
    for eye in ((0, 0, 1), (0, 0, -1)):
        assert np.allclose(Camera.from_fov(look_at(eye, (0, 0, 0)), 4, 4, 50).forward, [0, 0, -eye[2]])
    with pytest.raises(ValueError, match="stands at"):
        look_at((1, 2, 3), (1, 2, 3))


def test_an_orbit_stands_on_a_circle_and_looks_at_its_target():
    target = np.array([0.5, -0.2, 0.3])
    centres = np.array([pose[:3, 3] for pose in orbit(target, 2.0, 30, 8, start_deg=90)])
    assert np.allclose(np.linalg.norm(centres - target, axis=1), 2)
    assert np.allclose(centres[:, 2] - target[2], 1)
    assert np.allclose(centres[0] - target, [0, np.sqrt(3), 1])
    steps = np.linalg.norm(np.diff(np.concatenate([centres, centres[:1]]), axis=0), axis=1)
    assert np.allclose(steps, steps[0])


def test_part_of_an_orbit_reaches_both_ends():
    centres = np.array([pose[:3, 3] for pose in orbit((0, 0, 0), 1, 0, 3, start_deg=0, sweep_deg=90)])
    assert np.allclose(centres, [[1, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0], [0, 1, 0]])


@given(lenses(), position, st.integers(1, 5000), st.integers(1, 5000))
def test_a_resized_camera_sees_the_same_at_scaled_pixels(camera, point, width, height):
    assume(camera.depth(point) > 1e-2)
    scaled = camera.project(point) * [width / camera.width, height / camera.height]
    assert np.allclose(camera.resized(width, height).project(point), scaled, rtol=1e-9, atol=1e-6)


@given(lenses(), position, similarities())
def test_a_moved_camera_sees_moved_points_at_the_same_pixels(camera, point, to_from_world):
    assume(camera.depth(point) > 0.05)
    moved_point = to_from_world[:3, :3] @ point + to_from_world[:3, 3]
    assert np.allclose(camera.moved(to_from_world).project(moved_point), camera.project(point), rtol=1e-5, atol=1e-3)


@given(poses())
def test_the_inverse_undoes_a_pose(pose):
    assert np.allclose(invert(pose) @ pose, np.eye(4)) and np.allclose(pose @ invert(pose), np.eye(4))


def test_lines_at_right_angles_are_as_far_apart_as_they_are():
    along_a, along_b, gap = ray_distance([0, 0, 0], np.array([1.0, 0, 0]), [2, -3, 0.5], np.array([0, 1.0, 0]))
    assert (along_a, along_b, gap) == pytest.approx((2, 3, 0.5))


@given(position, position, position)
def test_lines_through_one_point_have_no_gap(a, b, point):
    u, v = point - a, point - b
    assume(np.linalg.norm(u) > 0.1 and np.linalg.norm(v) > 0.1)
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    assume(np.linalg.norm(np.cross(u, v)) > 0.1)
    along_a, along_b, gap = ray_distance(a, u, b, v)
    assert gap == pytest.approx(0, abs=1e-7)
    assert np.allclose(a + along_a * u, point) and np.allclose(b + along_b * v, point)


def test_parallel_lines_have_no_nearest_points():
    direction = np.array([0, 0, 1.0])
    assert np.isnan(ray_distance([0, 0, 0], direction, [1, 0, 0], direction)[0])


def test_a_camera_cannot_be_changed_and_does_not_hold_the_callers_array():
    K = np.diag([10.0, 10.0, 1.0])
    camera = Camera(K, np.eye(4), 4, 4)
    K[0, 0] = 99
    assert camera.K[0, 0] == 10
    with pytest.raises(ValueError):
        camera.K[0, 0] = 3


@pytest.mark.parametrize(
    "pose", [np.diag([2.0, 1, 1, 1]), np.diag([-1.0, 1, 1, 1]), np.full((4, 4), np.nan), np.eye(3)]
)
def test_a_pose_that_is_no_rigid_transform_is_refused(pose):
    with pytest.raises(ValueError, match="a camera"):
        Camera(np.eye(3), pose, 4, 4)


def test_a_view_whose_picture_does_not_fit_its_camera_is_refused():
    camera = Camera.from_fov(np.eye(4), 4, 2, 90)
    with pytest.raises(ValueError, match="view a.*uint8"):
        View("a", camera, np.zeros((4, 2, 3), np.uint8))


def test_the_point_nearest_to_rays_is_where_they_meet_or_else_least_squares():
    rng = np.random.default_rng(0)
    x, directions = rng.normal(size=(5, 1, 3)), rng.normal(size=(5, 4, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origins = x - directions * rng.uniform(1, 3, (5, 4, 1))
    assert np.abs(nearest_to_rays(origins, directions) - x[:, 0]).max() < 1e-12
    off = origins + 0.1 * rng.normal(size=origins.shape)
    across = np.eye(3) - directions[..., None] * directions[..., None, :]
    cost = lambda point: (np.einsum("nvij,nvj->nvi", across, point[:, None] - off) ** 2).sum((1, 2))
    best = nearest_to_rays(off, directions)
    assert all((cost(best + step) > cost(best)).all() for step in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]))
    parallel = nearest_to_rays([[1.0, 0, 5], [-1, 0, 5]], [[0, 0, 1.0], [0, 0, 1]])
    assert np.abs(parallel).max() < 1e-12
