import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scene.camera import Camera, look_at
from teach.sketch import Event, Sketch, SketchError, Stroke, check, dumps, load, loads, ray_angle, save

LINE = [[10.0, 20.0], [30.0, 20.0], [30.0, 60.0]]
TARGET = np.array([0.5, 0.0, 0.4])


def camera(eye=(-0.3, -0.8, 0.8), target=TARGET):
    return Camera.from_fov(look_at(eye, target), 640, 480, 60)


def seen(name, eye, points):
    view = camera(eye)
    return Sketch(name, view, (Stroke(view.project(points), np.arange(len(points))),))


def path(count=30):
    s = np.linspace(0, 1, count)
    return TARGET + np.stack([0.2 * s, 0.1 * np.sin(4 * s), 0.2 * s**2], axis=1)


@pytest.mark.parametrize(
    "points, times, words",
    [
        ([[0, 0]], [0], "needs 2"),
        ([], [], "points"),
        ([[0, 0], [1, np.nan]], [0, 1], "NaN"),
        ([[0, 0], [1, 1]], [0, np.inf], "infinite"),
        ([[0, 0], [1, 1], [2, 2]], [0, 2, 1], "backwards"),
        ([[0, 0, 0], [1, 1, 1]], [0, 1], "points"),
        ([[0, 0], [1, 1]], [0, 1, 2], "points"),
        ([[0, 0], [1, "a"]], [0, 1], "numbers"),
        ([[0, 0], [1e9, 1]], [0, 1], "not on any picture"),
    ],
)
def test_a_stroke_that_cannot_be_one_is_refused_in_words(points, times, words):
    with pytest.raises(SketchError, match=words):
        Stroke(points, times)


def test_equal_times_are_allowed_and_other_fields_are_checked():
    assert Stroke(LINE, [0, 0, 1]).duration == 1
    with pytest.raises(SketchError, match="kind"):
        Stroke(LINE, [0, 1, 2], kind="wish")
    with pytest.raises(SketchError, match="pressure"):
        Stroke(LINE, [0, 1, 2], pressure=[1, 2])


def test_a_stroke_is_a_value_that_neither_follows_nor_changes_its_source():
    source = np.array(LINE)
    stroke = Stroke(source, [0, 1, 2])
    source[:] = 0
    assert stroke.points[0].tolist() == LINE[0]
    with pytest.raises(ValueError):
        stroke.points[0] = 0


def test_arc_length_ignores_the_drawing_speed():
    stroke = Stroke(LINE, [0, 5, 5.1])
    assert stroke.length == 60 and np.allclose(stroke.arc_length, [0, 1 / 3, 1])
    assert np.allclose(stroke.at([0, 0.5, 1]), [[10, 20], [30, 30], [30, 60]])


numbers = st.floats(-1e6, 1e6)


@settings(max_examples=40, deadline=None)
@given(points=arrays(float, st.tuples(st.integers(2, 20), st.just(2)), elements=numbers), data=st.data())
def test_every_number_is_read_back_exactly(points, data):
    times = np.sort(data.draw(arrays(float, len(points), elements=numbers)))
    pressure = data.draw(st.none() | arrays(float, len(points), elements=numbers))
    stroke = Stroke(points, times, 3, "keep_out", (Event("gripper_close", 0.1),), pressure, "pen")
    [back] = loads(dumps([Sketch("view", camera(), (stroke,))]))
    [again] = back.strokes
    assert np.array_equal(again.points, points) and np.array_equal(again.times, times)
    assert np.array_equal(back.camera.K, camera().K)
    assert np.array_equal(back.camera.world_from_camera, camera().world_from_camera)
    assert (again.demonstration, again.kind, again.events, again.pointer) == (3, "keep_out", stroke.events, "pen")
    assert again.pressure is None if pressure is None else np.array_equal(again.pressure, pressure)


def document():
    return json.loads(dumps([seen("a", (-0.3, -0.8, 0.8), path(4))]))


def broken(edit):
    value = document()
    edit(value)
    return json.dumps(value)


@pytest.mark.parametrize(
    "edit, words",
    [
        (lambda d: d.update(version=2), r"version is '2'"),
        (lambda d: d.update(schema="other"), "schema"),
        (lambda d: d.update(extra=1), "extra is unknown"),
        (lambda d: d["sketches"][0].pop("camera"), r"sketches\[0\].camera is missing"),
        (lambda d: d["sketches"][0]["camera"].pop("K"), r"sketches\[0\].camera.K is missing"),
        (lambda d: d["sketches"][0]["camera"].update(width=0), "intrinsics"),
        (lambda d: d["sketches"][0]["camera"].update(width="wide"), r"camera.width must be of type integer"),
        (lambda d: d["sketches"][0]["camera"].update(world_from_camera=[[1] * 4] * 4), r"\[0\].camera: .*rotation"),
        (lambda d: d["sketches"][0]["camera"].update(K=[[1, 2, 3]]), r"camera.K must be a list of 3 items"),
        (lambda d: d["sketches"][0]["strokes"][0]["points"].append([1]), r"\[0\].points\[4\] must be a list of 2"),
        (lambda d: d["sketches"][0]["strokes"][0]["points"][2].__setitem__(0, None), r"points\[2\]\[0\] is None"),
        (lambda d: d["sketches"][0]["strokes"][0]["points"][2].__setitem__(0, True), r"points\[2\]\[0\] is True"),
        (lambda d: d["sketches"][0]["strokes"][0]["times"].__setitem__(0, 10**400), r"times\[0\] is 1000"),
        (lambda d: d["sketches"][0]["strokes"][0]["times"].pop(), r"strokes\[0\]: .*times"),
        (lambda d: d["sketches"][0]["strokes"][0].update(kind="wish"), "kind"),
        (lambda d: d["sketches"][0].update(view="x" * 1000), "at most 200"),
    ],
)
def test_a_file_is_refused_with_the_path_of_what_is_wrong(edit, words):
    with pytest.raises(SketchError, match=words):
        loads(broken(edit))


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "null", "[]", b"\xff\xfe\x00"])
def test_what_is_not_a_sketch_file_is_refused(text, tmp_path):
    with pytest.raises(SketchError):
        loads(text)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(number):
    text = dumps([seen("a", (-0.3, -0.8, 0.8), path(4))]).replace('"times": [0.0', f'"times": [{number}')
    with pytest.raises(SketchError, match=r"times\[0\]"):
        loads(text)


def test_save_replaces_the_file_whole_and_leaves_nothing_else(tmp_path):
    sketches = [seen("a", (-0.3, -0.8, 0.8), path())]
    target = tmp_path / "sketches" / "reach.json"
    save(target, sketches)
    save(target, sketches)
    assert [file.name for file in target.parent.iterdir()] == ["reach.json"]
    assert load(target)[0].view == "a"
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.json")


def test_two_views_from_different_sides_pass_the_check():
    a, b = seen("a", (-0.3, -0.8, 0.8), path()), seen("b", (-0.3, 0.8, 0.8), path())
    check([a, b])
    towards = [(c - path()[15]) / np.linalg.norm(c - path()[15]) for c in (a.camera.centre, b.camera.centre)]
    assert abs(ray_angle(a, b) - np.degrees(np.arccos(np.dot(*towards)))) < 6


def test_one_view_or_two_identical_ones_cannot_show_depth():
    a = seen("a", (-0.3, -0.8, 0.8), path())
    with pytest.raises(SketchError, match="no view"):
        check([])
    with pytest.raises(SketchError, match="only on view 'a'"):
        check([a])
    with pytest.raises(SketchError, match="never cross well: 0 degrees"):
        check([a, Sketch("b", a.camera, a.strokes)])
    with pytest.raises(SketchError, match="never cross well"):
        check([a, seen("b", (-0.29, -0.8, 0.8), path())])
    with pytest.raises(SketchError, match="share"):
        check([a, Sketch("a", camera((-0.3, 0.8, 0.8)), a.strokes)])


def test_one_view_is_enough_where_its_surface_is_known():
    a = seen("a", (-0.3, -0.8, 0.8), path())
    check([a], surfaces={"a"})
    check([a, Sketch("b", a.camera, ())], surfaces={"a"})
    with pytest.raises(SketchError, match="only on view 'a'.*depth picture of that view"):
        check([a], surfaces={"b"})
    with pytest.raises(SketchError, match="no view"):
        check([], surfaces={"a"})
    with pytest.raises(SketchError, match="share"):
        check([a, a], surfaces={"a"})


def test_rays_that_meet_behind_the_cameras_do_not_pass_the_check():
    a, b = seen("a", (-0.3, -0.8, 0.8), path()), seen("b", (-0.3, 0.8, 0.8), path())
    with pytest.raises(SketchError, match="never cross well"):
        left, right = (Stroke([[u, 200], [u, 240]], [0, 1]) for u in (-960, 1600))
        check([Sketch("a", a.camera, (right,)), Sketch("b", b.camera, (left,))])


def test_a_stroke_that_does_not_move_is_named():
    a, b = seen("a", (-0.3, -0.8, 0.8), path()), seen("b", (-0.3, 0.8, 0.8), path())
    still = Stroke([[5, 5], [5, 5]], [0, 1])
    with pytest.raises(SketchError, match="stroke 1 on view 'b' does not move"):
        check([a, Sketch("b", b.camera, (*b.strokes, still))])
