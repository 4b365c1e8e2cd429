import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.align import arc_length, backwards, common_times, oriented, resample, speed_profile
from teach.sketch import Event, Sketch, SketchError, Stroke

TARGET = np.array([0.5, 0.0, 0.4])
EYES = ((-0.3, -0.9, 0.9), (1.3, -0.7, 0.8), (0.4, 1.0, 1.1), (-0.5, 0.3, 0.6))
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
    moments = [np.interp(t, view[0], s) for view in common_times(drawn, time).times]
    return np.ptp(moments, axis=0).max()


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


def test_a_view_that_draws_something_else_is_found_among_four_and_how_far_it_is_off():
    drawn = sketches(4)
    other = Stroke(drawn[2].strokes[0].points @ [[0.6, 0.8], [-0.8, 0.6]] + [240, -160], np.linspace(0, 1, 300))
    drawn[2] = Sketch("v2", CAMERAS[2], (other,) * 3)
    common = common_times(drawn)
    assert common.agree.tolist() == [True, True, False, True]
    assert common.off[2] > 20 > 5 * common.off[[0, 1, 3]].max()
    assert common_times(drawn, robust=False).agree.all()


def test_the_skills_time_is_the_median_of_how_people_drew():
    slow_middle = lambda s: s + 0.1 * np.sin(2 * np.pi * s)
    t = speed_profile(sketches(2, [slow_middle, slow_middle]), [[np.linspace(0, 1, 300)] * 3] * 2)
    assert np.allclose(t, np.linspace(0, 1, 100), atol=0.02)  # moments that pass evenly in drawn time
    moments = [[slow_middle(np.linspace(0, 1, 300))] * 3] * 2
    t, u = speed_profile(sketches(2, [slow_middle, slow_middle]), moments), np.linspace(0, 1, 100)
    assert np.abs(slow_middle(t) - u).max() < 0.03
    assert (np.diff(t) > 0).all() and t[0] == 0 and t[-1] == 1


def test_a_pause_in_one_stroke_does_no_harm():
    drawn, s = sketches(), np.linspace(0, 1, 300)
    paused = Stroke(drawn[0].strokes[0].points, np.where(s > 0.4, s + 5, s))
    changed = [Sketch("v0", CAMERAS[0], (paused, *drawn[0].strokes[1:])), drawn[1]]
    before, after = (common_times(sketch).times[0][1] for sketch in (drawn, changed))
    assert np.abs(before - after).max() < 0.01


def test_uniform_speed_is_uniform_in_space():
    times = common_times(sketches(), speed="uniform").times[0][0]
    x = hook(np.interp(np.linspace(0, 1, 50), times, np.linspace(0, 1, 300)))
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    assert steps.std() < 0.15 * steps.mean()


def test_strokes_drawn_backwards_are_turned_round_and_it_is_said():
    drawn = sketches(3)
    odd = Sketch("v1", CAMERAS[1], (*drawn[1].strokes[:2], backwards(drawn[1].strokes[2])))
    turned, notes = oriented([drawn[0], odd, drawn[2]])
    assert notes == ["Stroke 3 on view v1 was drawn backwards; it is taken the other way round."]
    assert np.array_equal(turned[1].strokes[2].points, drawn[1].strokes[2].points)
    against = Sketch("v2", CAMERAS[2], tuple(backwards(stroke) for stroke in drawn[2].strokes))
    turned, notes = oriented([drawn[0], drawn[1], against])
    assert len(notes) == 1 and "View v2 was drawn from the other end than the other views" in notes[0]
    assert np.array_equal(turned[2].strokes[0].points, drawn[2].strokes[0].points)
    assert oriented(drawn)[1] == []


def test_a_stroke_backwards_twice_is_itself_with_its_events():
    stroke = Stroke([[0, 0], [1, 0], [3, 0]], [1, 2, 5], events=(Event("gripper_close", 2.0),), pressure=[1, 2, 3])
    there = backwards(stroke)
    assert there.events[0].time == 4 and there.times.tolist() == [1, 4, 5] and there.pressure.tolist() == [3, 2, 1]
    back = backwards(there)
    assert np.array_equal(back.points, stroke.points) and back.events == stroke.events


def test_times_do_not_decrease_and_end_at_one_whatever_is_drawn():
    rng = np.random.default_rng(0)
    for _ in range(5):
        strokes = [Stroke(rng.uniform(0, 480, (8, 2)), np.arange(8)) for _ in range(2)]
        drawn = [Sketch(f"v{i}", CAMERAS[i], (stroke,)) for i, stroke in enumerate(strokes)]
        for [times] in common_times(drawn, "aligned").times:
            assert (np.diff(times) >= 0).all() and times[0] == 0 and times[-1] == 1


def test_drawn_time_is_the_strokes_own():
    stroke = Stroke([[0, 0], [10, 0], [20, 0]], [1, 4, 5])
    [[times]] = common_times([Sketch("a", CAMERAS[0], (stroke,))], "drawn").times
    assert np.allclose(times, [0, 0.75, 1])
    assert np.allclose(resample(stroke, times, 5)[:, 0], [0, 10 / 3, 20 / 3, 10, 20])
    with pytest.raises(SketchError, match="no time"):
        common_times([Sketch("a", CAMERAS[0], (Stroke([[0, 0], [1, 1]], [0, 0]),))], "drawn")
    with pytest.raises(ValueError, match="aligned"):
        common_times([], "later")
    with pytest.raises(ValueError, match="uniform"):
        common_times([], speed="fast")
