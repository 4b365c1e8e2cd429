from dataclasses import replace

import cv2
import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.curve import arc_length, extent, resample
from teach.hand import PARTS, Hand, measure, scaled
from teach.scripted import draw, intended_paths, picture_flow, sketch, smooth_path
from teach.sketch import SketchError

VIA = np.array([[0.31, 0.0, 0.49], [0.41, 0.12, 0.60], [0.56, 0.19, 0.59], [0.69, 0.14, 0.46], [0.83, 0.10, 0.30]])
CAMERA = Camera.from_fov(look_at([-0.30, 0.90, 1.05], [0.66, 0.09, 0.38]), 640, 480, 50)
ALONG = Camera.from_fov(look_at([-0.70, 0.0, 0.80], [0.66, 0.09, 0.38]), 640, 480, 50)
STEADY = replace(scaled(Hand(), 0.0), tremor=0.0)
H, W = 480, 640


def rng(seed=0):
    return np.random.default_rng(seed)


def texture(seed, blur=2.5):
    noise = cv2.GaussianBlur(rng(seed).uniform(0, 255, (H + 40, W + 40, 3)).astype(np.float32), (0, 0), blur)
    return (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)


# --- paths -----------------------------------------------------------------------------------------------------------


def test_the_path_passes_through_its_via_points():
    path = smooth_path(VIA, 2000)
    for point in VIA:
        assert np.linalg.norm(path - point, axis=1).min() < 1e-3
    np.testing.assert_allclose(path[[0, -1]], VIA[[0, -1]])


def test_the_path_is_smooth_and_equally_spaced():
    path = smooth_path(VIA)
    steps = np.diff(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    np.testing.assert_allclose(lengths, lengths.mean(), rtol=1e-3)
    cosines = (steps[1:] * steps[:-1]).sum(axis=1) / (lengths[1:] * lengths[:-1])
    assert np.degrees(np.arccos(cosines.min())) < 5


def test_two_via_points_give_a_straight_line():
    np.testing.assert_allclose(smooth_path([[0, 0, 0], [1, 2, 3]], 4), np.linspace([0, 0, 0], [1, 2, 3], 4), atol=1e-9)


@pytest.mark.parametrize(
    "via", [[[0, 0, 0]], [[0, 0], [1, 1]], [[0, 0, 0], [np.nan, 0, 0]], [[0, 0, 0], [0, 0, 0], [1, 0, 0]]]
)
def test_via_points_that_make_no_path_are_refused(via):
    with pytest.raises(ValueError, match="via point"):
        smooth_path(via)


def test_intended_paths_have_their_share_of_the_hand_s_variance():
    found = measure(intended_paths(VIA, 400, Hand(intent_share=0.25), rng()))
    assert found == pytest.approx({name: 0.5 * getattr(Hand(), name) for name in PARTS}, rel=0.15)


def test_a_user_who_means_one_path_means_it_each_time():
    np.testing.assert_allclose(intended_paths(VIA, 2, Hand(intent_share=0.0), rng())[1], smooth_path(VIA), atol=1e-5)


# --- strokes ---------------------------------------------------------------------------------------------------------


def test_a_steady_hand_draws_the_projection():
    path = smooth_path(VIA)
    stroke = draw(path, CAMERA, STEADY, rng(), demonstration=7)
    expected = resample(CAMERA.project(path), 300)
    np.testing.assert_allclose(resample(stroke.points, 300), expected, atol=0.1)
    assert stroke.demonstration == 7


def total(parts, reach):
    """RMS deviation along a curve whose points lie ``reach`` from its centroid, all as fractions of its extent."""
    return np.sqrt(parts["offset"] ** 2 + (reach * parts["size"]) ** 2 + parts["smooth"] ** 2)


@pytest.mark.parametrize(
    ("camera", "share"),
    [(CAMERA, 0.0), (CAMERA, 0.5), (ALONG, 0.5), (ALONG, 1.0)],
    ids=["side, drawn", "side, half", "behind, half", "behind, meant"],
)
def test_strokes_have_the_hand_s_faults_in_the_picture_however_they_are_shared(camera, share):
    hand = Hand(intent_share=share, tremor=0.0)
    drawn, _ = sketch("a", camera, VIA, hand, rng(1), count=60)
    found = measure([stroke.points for stroke in drawn.strokes])
    arms = resample(camera.project(smooth_path(VIA)), 200)
    reach = np.sqrt(((arms - arms.mean(axis=0)) ** 2).sum(axis=1).mean()) / extent(arms)
    assert total(found, reach) == pytest.approx(total({name: getattr(hand, name) for name in PARTS}, reach), rel=0.1)
    assert found == pytest.approx({name: getattr(hand, name) for name in PARTS}, rel=0.25)


def test_a_stroke_has_a_person_s_duration_and_rate():
    stroke = draw(smooth_path(VIA), CAMERA, Hand(), rng())
    assert 2 <= stroke.duration <= 4
    np.testing.assert_allclose(np.diff(stroke.times), 0.01, rtol=0.01)


def test_every_stroke_has_its_own_speed():
    drawn, _ = sketch("a", CAMERA, VIA, replace(STEADY, speed=(0.6, 0.6)), rng())
    progress = []
    for stroke in drawn.strokes:
        along = arc_length(stroke.points)
        progress.append(np.interp(np.linspace(0, 1, 50), stroke.times / stroke.duration, along / along[-1]))
    assert np.abs(progress[0] - progress[1]).max() > 0.03
    assert np.abs(progress[0] - progress[2]).max() > 0.03


def test_strokes_are_drawn_on_the_shown_picture():
    flow = np.broadcast_to([3.0, -2.0], (H, W, 2))
    path = smooth_path(VIA)
    plain, moved = (draw(path, CAMERA, Hand(), rng(2), flow=f) for f in (None, flow))
    np.testing.assert_allclose(moved.points - plain.points, np.broadcast_to([3.0, -2.0], plain.points.shape), atol=1e-6)


def test_the_flow_is_read_at_pixel_centres():
    flow = np.zeros((H, W, 2))
    flow[..., 0] = 0.02 * (np.arange(W) + 0.5)  # 2 % of the pixel's own coordinate
    path = smooth_path(VIA)
    plain, moved = (resample(draw(path, CAMERA, STEADY, rng(), flow=f).points, 100) for f in (None, flow))
    np.testing.assert_allclose(moved[[0, -1], 0], 1.02 * plain[[0, -1], 0], atol=1e-6)


def test_a_coarse_pen_draws_on_its_grid():
    points = draw(smooth_path(VIA), CAMERA, Hand(grid=1.0), rng()).points
    np.testing.assert_array_equal(points, np.round(points))


def test_a_sketch_numbers_its_demonstrations_and_tells_what_was_meant():
    drawn, paths = sketch("left", CAMERA, VIA, Hand(), rng(), count=3, first=3)
    assert drawn.view == "left" and drawn.camera is CAMERA
    assert [stroke.demonstration for stroke in drawn.strokes] == [3, 4, 5]
    assert paths.shape == (3, 200, 3)
    assert np.linalg.norm(paths[0] - paths[1], axis=1).max() > 0.005


def test_the_same_seed_gives_the_same_sketch():
    first, second = (sketch("a", CAMERA, VIA, Hand(), rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first[1], second[1])
    for a, b in zip(first[0].strokes, second[0].strokes, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.times, b.times)


def test_a_view_that_does_not_see_the_whole_motion_is_refused():
    narrow = Camera.from_fov(CAMERA.world_from_camera, W, H, 15)
    with pytest.raises(SketchError, match="does not see the whole motion"):
        draw(smooth_path(VIA), narrow, Hand(), rng())


def test_a_camera_in_the_middle_of_the_motion_is_refused():
    inside = Camera.from_fov(look_at(VIA[2], VIA[4]), W, H, 60)
    with pytest.raises(SketchError, match="behind the camera"):
        draw(smooth_path(VIA), inside, Hand(), rng())


# --- flow ------------------------------------------------------------------------------------------------------------

PICTURE = texture(0)
TRUE = PICTURE[10 : 10 + H, 10 : 10 + W]
SHIFTED = PICTURE[12 : 12 + H, 7 : 7 + W]  # what TRUE shows at p, this shows at p + (3, -2)


def test_the_flow_of_a_shifted_picture_is_the_shift():
    flow = picture_flow(TRUE, SHIFTED)
    assert flow.shape == (H, W, 2)
    np.testing.assert_allclose(flow, np.broadcast_to([3.0, -2.0], flow.shape), atol=0.2)


def test_the_flow_of_equal_pictures_is_zero():
    np.testing.assert_allclose(picture_flow(TRUE, TRUE), 0, atol=1e-3)


def test_exposure_moves_nothing():
    darker = (0.6 * SHIFTED.astype(float) + 10).astype(np.uint8)
    np.testing.assert_allclose(picture_flow(TRUE, darker), np.broadcast_to([3.0, -2.0], (H, W, 2)), atol=0.3)


def test_what_shows_nothing_takes_the_flow_of_the_rest():
    foggy = SHIFTED.copy()
    foggy[:, W // 2 :] = 127
    flow = picture_flow(TRUE, foggy)
    np.testing.assert_allclose(flow, np.broadcast_to([3.0, -2.0], flow.shape), atol=0.7)


def test_garbage_does_not_bend_strokes():
    garbage = rng(9).integers(0, 255, (H, W, 3)).astype(np.uint8)
    half = SHIFTED.copy()
    half[:, W // 2 :] = garbage[:, W // 2 :]
    assert np.linalg.norm(picture_flow(TRUE, half) - [3.0, -2.0], axis=-1).max() < 4
    assert np.linalg.norm(picture_flow(TRUE, garbage), axis=-1).max() < 6
    assert np.linalg.norm(picture_flow(TRUE, texture(5)[:H, :W]), axis=-1).max() < 8


def test_a_picture_without_texture_has_no_flow():
    np.testing.assert_allclose(picture_flow(TRUE, np.full_like(TRUE, 90)), 0, atol=0.1)
    np.testing.assert_allclose(picture_flow(np.full_like(TRUE, 90), TRUE), 0, atol=0.1)
