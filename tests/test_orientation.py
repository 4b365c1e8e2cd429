"""How the hand is held: chosen in a sketch file, or drawn as an arrow on several views."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from teach.orientation import axis_of, chosen
from teach.rptl import fit
from teach.sketch import Sketch, SketchError, Stroke, dumps, loads
from teach.trajectory import Skill

CAMERAS = [Camera.from_fov(look_at(eye, [0, 0, 0.1]), 640, 480, 50) for eye in ([1.0, 0.7, 0.8], [0.9, -0.8, 0.9], [0.4, 0.0, 1.5])]
T = np.linspace(0, 1, 30)
CURVE = np.column_stack([0.1 * np.sin(3 * T), 0.4 * T - 0.2, 0.1 + 0.3 * T * (1 - T)])


def arrow(camera, axis, tail=(0.05, 0.02, 0.2), length=0.15) -> Stroke:
    ends = np.array(tail) + np.array([[0.0], [1.0]]) * length * np.asarray(axis)
    return Stroke(camera.project(ends), [0.0, 0.5], kind="arrow")


def sketches(orientation=None, arrows=(), views=2) -> list[Sketch]:
    drawn = [(Stroke(camera.project(CURVE), T),) for camera in CAMERAS[:views]]
    with_arrow = [(*strokes, arrow(CAMERAS[k], arrows)) if len(arrows) else strokes for k, strokes in enumerate(drawn)]
    return [Sketch(f"view{k}", CAMERAS[k], strokes, orientation) for k, strokes in enumerate(with_arrow)]


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.2), st.integers(2, 3))
def test_an_arrow_seen_by_several_cameras_has_its_direction(vector, count):
    d = np.array(vector) / np.linalg.norm(vector)
    ends = [camera.project(np.array([0.05, 0.02, 0.2]) + np.array([[0.0], [0.15]]) * d) for camera in CAMERAS[:count]]
    try:
        found = axis_of(CAMERAS[:count], ends)
    except ValueError as error:
        normals = [np.cross(*camera.rays(pixels)[1]) for camera, pixels in zip(CAMERAS, ends)]
        apart = np.linalg.norm(np.cross(*[n / np.linalg.norm(n) for n in normals[:2]]))
        assert "one plane" in str(error) and apart < 0.25  # two views see it in nearly the plane that they lie in
    else:
        np.testing.assert_allclose(found, d, atol=1e-6)


def test_what_is_chosen_is_kept_by_the_file_and_the_skill(tmp_path):
    for orientation in ({"kind": "keep"}, {"kind": "down"}, {"kind": "along", "axis": [0.0, 0.6, -0.8]}):
        back = loads(dumps(sketches(orientation)))
        assert [sketch.orientation for sketch in back] == [orientation] * 2
        skill = fit(back, seed=0) if orientation["kind"] == "along" else Skill(SKILL.distribution, 1.0, orientation=orientation)
        assert skill.orientation == orientation
        skill.save(tmp_path / "skill.npz")
        assert Skill.load(tmp_path / "skill.npz").orientation == orientation
        assert skill.hand == orientation.get("axis", orientation["kind"])
    assert dumps(sketches()) == dumps(loads(dumps(sketches()))) and "orientation" not in dumps(sketches())


SKILL = fit(sketches(), seed=0)


def test_a_skill_of_which_nothing_is_said_leaves_the_hand_free():
    assert SKILL.orientation is None and SKILL.hand is None


def test_an_arrow_drawn_on_two_views_is_where_the_hand_points():
    d = np.array([0.6, 0.0, -0.8])
    said = chosen(sketches({"kind": "along"}, d))
    np.testing.assert_allclose(said["axis"], d, atol=1e-9)
    assert chosen(sketches(None, d)) is None  # drawn, but not chosen


@pytest.mark.parametrize(
    "made, words",
    [
        (lambda: chosen(sketches({"kind": "along"})), "drawn on no view"),
        (lambda: chosen([sketches({"kind": "along"}, [0, 0, -1])[0], sketches({"kind": "along"})[1]]), "only on view 'view0'"),
        (lambda: chosen([sketches({"kind": "keep"})[0], sketches({"kind": "down"})[1]]), "different ways"),
        (lambda: sketches({"kind": "keep", "axis": [0, 0, 1]}), "has no axis"),
        (lambda: sketches({"kind": "along", "axis": [0, 0, 0]}), "no direction"),
        (lambda: sketches({"kind": "sideways"}), "expected one of"),
        (lambda: Skill(SKILL.distribution, 1.0, orientation={"kind": "along"}), "has an axis"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_reason(made, words):
    with pytest.raises(ValueError, match=words):
        made()


def test_arrows_that_point_to_opposite_sides_are_told():
    one, two = sketches({"kind": "along"}, [0, 0, -1])
    turned = Stroke(two.arrows[0].points[::-1], [0.0, 0.5], kind="arrow")
    with pytest.raises(SketchError, match="opposite sides"):
        chosen([one, Sketch(two.view, two.camera, (*two.motions, turned), two.orientation)])
