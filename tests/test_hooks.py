"""The short way back that a pen draws as it lands or leaves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scene.camera import Camera
from teach.align import backwards
from teach.hooks import hook, without_hooks
from teach.sketch import Event, Sketch, Stroke

t = np.linspace(0, 1, 150)
ARC = np.stack([80 + 400 * t, 300 - 150 * np.sin(np.pi * t)], axis=1)


def hooked(length, aside_deg=40.0, points=ARC):
    """The arc as somebody draws it who lands ``length`` px on from its beginning and goes back there."""
    way = points[1] - points[0]
    angle = np.arctan2(way[1], way[0]) + np.radians(aside_deg)
    back = points[0] + length * np.linspace(1, 0, 12)[:-1, None] * [np.cos(angle), np.sin(angle)]
    return Stroke(np.concatenate([back, points]), np.linspace(0, 2, len(back) + len(points)))


def sketch(*strokes):
    return Sketch("view1", Camera.from_fov(np.eye(4), 640, 480, 60), strokes)


@pytest.mark.parametrize("end", ["begins", "ends"])
@pytest.mark.parametrize("length", [10, 25])
def test_a_hook_is_left_out_and_said(end, length):
    strokes = [Stroke(ARC, t), hooked(length), Stroke(ARC + [0, 3], t)]
    [mended], notes = without_hooks([sketch(*(strokes if end == "begins" else map(backwards, strokes)))])
    assert np.linalg.norm(mended.strokes[1].points[0 if end == "begins" else -1] - ARC[0]) < 4
    assert len(notes) == 1 and f"Stroke 2 on view view1 {end} with a hook of" in notes[0]
    assert not without_hooks([mended])[1]


@given(st.integers(3, 30), st.floats(-65, 65))  # it turns back by 115 degrees or more, clear of the bound
def test_whichever_way_it_turns_the_motion_begins_where_it_was_meant(length, aside):
    [mended], _ = without_hooks([sketch(hooked(length, aside), Stroke(ARC, t))])
    assert np.linalg.norm(mended.strokes[0].points[0] - ARC[0]) < max(6, 0.2 * length)  # within half of the ruler


def test_a_way_back_that_is_meant_and_a_stroke_without_hook_are_kept():
    far = hooked(80)
    corner = Stroke(np.concatenate([ARC[:20], ARC[20] + np.outer(t, [0, 200])]), np.linspace(0, 1, 170))
    for stroke in (far, corner, Stroke(ARC, t), Stroke([[1, 2], [3, 4]], [0, 1])):
        assert hook(stroke) == 0 and without_hooks([sketch(stroke, stroke)])[0][0].strokes[0] is stroke


def test_what_all_strokes_of_a_view_do_is_meant_and_of_one_alone_nobody_can_tell():
    for strokes in ([hooked(20)], [hooked(20), hooked(22, 45), hooked(18, 35)]):
        assert hook(strokes[0]) > 0 and not without_hooks([sketch(*strokes)])[1]
    _, notes = without_hooks([sketch(hooked(20), hooked(20, -60), Stroke(ARC, t))])
    assert len(notes) == 2


def test_what_happens_on_a_hook_happens_where_the_motion_begins_and_outlines_are_kept():
    drawn = hooked(20)
    drawn = Stroke(drawn.points, drawn.times, events=(Event("gripper_close", 0.0),), pressure=np.ones(len(drawn.times)))
    outline = Stroke(drawn.points, drawn.times, kind="keep_out")
    [mended], notes = without_hooks([sketch(outline, drawn, Stroke(ARC, t))])
    assert mended.strokes[0] is outline and len(notes) == 1
    assert mended.strokes[1].events[0].time == mended.strokes[1].times[0] > 0
    assert mended.strokes[1].pressure.shape == mended.strokes[1].times.shape
