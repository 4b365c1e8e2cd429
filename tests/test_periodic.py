import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.periodic import unrolled
from teach.sketch import Sketch, SketchError, Stroke

CAMERA = Camera.from_fov(look_at((0, -1, 1), (0, 0, 0)), 640, 480, 60)


def circle(count, start=0.0, points=300):
    """(points, 2) px: so many times round, from the phase ``start``, clockwise in the picture."""
    angle = 2 * np.pi * np.linspace(start, start + count, points)
    return np.stack([300 + 100 * np.cos(angle), 220 + 60 * np.sin(angle)], axis=1)


def spiral(count):
    return 300 + np.linspace(0, 1, 300)[:, None] * (circle(count) - [300, 220])


def sketch(*lines, view="v"):
    return Sketch(view, CAMERA, tuple(Stroke(line, np.linspace(0, 3, len(line))) for line in lines))


def test_sketches_become_single_turns_numbered_as_demonstrations():
    outline = Stroke(circle(3), np.arange(300), kind="keep_out")
    one, other = sketch(circle(3), circle(2, 0.01)), sketch(circle(4), view="w")
    single, count = unrolled([Sketch("v", CAMERA, (outline, *one.strokes)), other])
    assert [stroke.demonstration for stroke in single[0].motions] == [0, 1, 2, 3, 4] and len(single[1].motions) == 4
    assert count == 3.0 and single[0].strokes[-1] is outline
    assert np.allclose([turn.duration for turn in single[0].motions], [1, 1, 1, 1.5, 1.5], rtol=0.03)


def test_turns_of_strokes_that_start_nearly_together_start_together():
    single, _ = unrolled([sketch(circle(3, -0.03), circle(3, 0.03), circle(2.97, 0.0))])
    starts = np.array([turn.points[0] for turn in single[0].motions])
    assert len(starts) == 9 and np.linalg.norm(starts - starts.mean(axis=0), axis=1).max() < 4


def test_sketches_with_a_stroke_that_does_not_go_round_and_round_are_left_as_they_are():
    for sketches in ([sketch(circle(3)), sketch(circle(1), view="w")], [sketch(circle(3), spiral(3))], [sketch()]):
        single, count = unrolled(sketches)
        assert count == 0 and all(a is b for a, b in zip(single, sketches, strict=True))
    assert unrolled([sketch(circle(3))], periodic=False)[1] == 0 < unrolled([sketch(circle(3))])[1]


@pytest.mark.parametrize("count", [0.95, 1.0, 1.3])
def test_a_closed_line_drawn_once_is_a_turn_if_asked_for(count):
    single, found = unrolled([sketch(circle(count)), sketch(circle(3), view="w")], periodic=True)
    turn = single[0].motions[0]
    assert [len(s.motions) for s in single] == [1, 3] and found == 2.0
    assert np.linalg.norm(turn.points[-1] - turn.points[0]) < 3
    assert np.isclose(turn.length, Stroke(circle(1), np.arange(300)).length, rtol=0.02)


def test_strokes_that_cannot_be_turns_of_one_motion_are_refused():
    with pytest.raises(SketchError, match="stroke 1 on view 'v' does not go round: close it"):
        unrolled([sketch(circle(1), circle(0.7))], periodic=True)
    with pytest.raises(SketchError, match="opposite direction to stroke 0"):
        unrolled([sketch(circle(3), circle(3)[::-1])])
    with pytest.raises(SketchError, match="'v' start up to 200 px apart"):
        unrolled([sketch(circle(3), circle(3, 0.5))])


def test_there_and_back_along_a_line_is_the_same_either_way():
    x = np.abs(np.linspace(0, 6, 300) % 2 - 1)
    line = np.stack([150 + 300 * x, 200 + 40 * x], axis=1)
    assert unrolled([sketch(line, line[::-1])])[1] == 3.0
