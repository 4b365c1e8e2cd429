import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.align import arc_length, common_times, correspondence, fundamental, resample, sampson
from teach.sketch import Sketch, SketchError, Stroke

TARGET = np.array([0.5, 0.0, 0.4])
EYES = ((-0.3, -0.9, 0.9), (1.3, -0.7, 0.8), (0.4, 1.0, 1.1))
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in EYES]


def hook(s):
    """A curve whose halves are foreshortened differently in the cameras."""
    return TARGET + np.stack([0.25 * np.cos(4 * s) - 0.05, 0.25 * np.sin(4 * s), 0.2 * s - 0.1], axis=-1)


def sketches(count=2, warps=None):
    s = np.linspace(0, 1, 300)
    warps = warps or [lambda s: s] * count
    strokes = [Stroke(camera.project(hook(warp(s))), s) for camera, warp in zip(CAMERAS, warps)]
    return [Sketch(f"v{i}", CAMERAS[i], (stroke,) * 3) for i, stroke in enumerate(strokes)]


def disagreement(drawn, time):
    """Largest distance [fraction of the true curve] between the moments that strokes of all views show at equal
    times."""
    s, t = np.linspace(0, 1, 300), np.linspace(0, 1, 50)
    moments = [np.interp(t, view[0], s) for view in common_times(drawn, time)]
    return np.ptp(moments, axis=0).max()


def test_points_of_one_place_satisfy_the_fundamental_matrix():
    a, b = (camera.project(hook(np.linspace(0, 1, 50))) for camera in CAMERAS[:2])
    F = fundamental(*CAMERAS[:2])
    assert np.abs(sampson(a, b, F)).max() < 1e-9
    normal = F @ np.append(a[0], 1)
    moved = b[:1] + normal[:2] / np.linalg.norm(normal[:2])  # one pixel off the epipolar line, shared by two pictures
    assert 0.5 < abs(sampson(a[:1], moved, F)[0]) < 1


def test_exact_strokes_are_aligned_where_arc_length_is_not():
    assert disagreement(sketches(), "arc_length") > 0.1
    assert disagreement(sketches(), "aligned") < 0.03  # for a while the curve runs along epipolar lines


def test_three_views_are_aligned_too():
    assert disagreement(sketches(3), "aligned") < 0.03


def test_drawing_speed_does_not_matter():
    slow_start, quick_start = (lambda s: s**2), (lambda s: np.sqrt(s))
    drawn = sketches(warps=[slow_start, quick_start])
    s = np.linspace(0, 1, 300)
    for sketch, warp in zip(drawn, (slow_start, quick_start)):
        along = arc_length(sketch.motions[0])
        steady = arc_length(sketches()[drawn.index(sketch)].motions[0])
        assert np.abs(along - np.interp(warp(s), s, steady)).max() < 0.02


def test_trembling_adds_no_arc_length():
    rng = np.random.default_rng(0)
    progress = np.concatenate([np.linspace(0, 0.5, 900), np.linspace(0.5, 1, 100)])  # the first half nine times slower
    points = np.column_stack([400 * progress, np.zeros(1000)]) + rng.normal(0, 1.0, (1000, 2))
    stroke = Stroke(points, np.arange(1000))
    assert stroke.arc_length[900] > 0.75  # the raw length is mostly trembling
    assert abs(arc_length(stroke)[900] - 0.5) < 0.03


def test_where_geometry_is_silent_equal_arc_length_stays():
    s = np.linspace(0, 1, 100)
    x = TARGET + np.stack([0 * s, 0.3 * (s - 0.5), 0 * s], axis=1)
    poses = [look_at(TARGET + [0.3, y, 0.9], TARGET, up=(1, 0, 0)) for y in (-0.5, 0.5)]
    cameras = [Camera.from_fov(pose, 640, 480, 55) for pose in poses]
    a, b = (camera.project(x)[None] + np.random.default_rng(0).normal(0, 0.5, (3, 1, 2)) for camera in cameras)
    in_a, in_b = correspondence(a, b, *cameras)  # the line runs along the baseline: along its own epipolar lines
    assert np.abs(in_a - in_b).max() < 0.02 and in_a[0] == in_b[0] == 0 and in_a[-1] == in_b[-1] == 1


def test_times_do_not_decrease_and_end_at_one_whatever_is_drawn():
    rng = np.random.default_rng(0)
    for _ in range(5):
        strokes = [Stroke(rng.uniform(0, 480, (8, 2)), np.arange(8)) for _ in range(2)]
        drawn = [Sketch(f"v{i}", CAMERAS[i], (stroke,)) for i, stroke in enumerate(strokes)]
        for [times] in common_times(drawn, "aligned"):
            assert (np.diff(times) >= 0).all() and times[0] == 0 and times[-1] == 1


def test_drawn_time_is_the_strokes_own():
    stroke = Stroke([[0, 0], [10, 0], [20, 0]], [1, 4, 5])
    [[times]] = common_times([Sketch("a", CAMERAS[0], (stroke,))], "drawn")
    assert np.allclose(times, [0, 0.75, 1])
    assert np.allclose(resample(stroke, times, 5)[:, 0], [0, 10 / 3, 20 / 3, 10, 20])
    with pytest.raises(SketchError, match="no time"):
        common_times([Sketch("a", CAMERAS[0], (Stroke([[0, 0], [1, 1]], [0, 0]),))], "drawn")
    with pytest.raises(ValueError, match="aligned"):
        common_times([], "later")
