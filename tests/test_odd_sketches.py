"""Whatever is drawn, a fit gives a finite motion with a sentence on what is odd, or one SketchError."""

from dataclasses import replace

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.density import Flow
from teach.rptl import fit
from teach.sketch import Sketch, SketchError, Stroke, without_slips

TARGET = np.array([0.5, 0.0, 0.4])
EYES = ((-0.3, -0.9, 0.9), (-0.3, 0.9, 0.7), (0.2, 0.2, 1.6))
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in EYES]
S = np.linspace(0, 1, 150)
QUICK = Flow(steps=20)


def reach(s):
    return TARGET + np.stack([0.3 * s - 0.15, 0.12 * np.sin(3 * s) - 0.06, 0.15 * np.cos(2.5 * s)], axis=-1)


def sketches(path=reach(S), cameras=CAMERAS[:2], noise=1.0, count=2):
    rng = np.random.default_rng(0)
    draw = lambda camera: camera.project(path) + noise * rng.standard_normal((len(path), 2))
    times = 3 * np.linspace(0, 1, len(path))
    return [Sketch(f"v{v}", c, tuple(Stroke(draw(c), times, k) for k in range(count))) for v, c in enumerate(cameras)]


def changed(drawn, view, points=lambda x: x, times=lambda t: t, only=None):
    strokes = [
        replace(s, points=points(s.points), times=times(s.times)) if only in (None, k) else s
        for k, s in enumerate(drawn[view].strokes)
    ]
    return [replace(sketch, strokes=tuple(strokes)) if v == view else sketch for v, sketch in enumerate(drawn)]


def turned(camera):
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    return replace(camera, world_from_camera=pose)


def off(skill, path=reach(np.linspace(0, 1, 1000))):
    """Largest distance [m] of the mean from the path."""
    return np.linalg.norm(skill.distribution.mean_at(S)[:, None] - path, axis=-1).min(axis=1).max()


def dot(points):
    return points[0] + (points - points[0]) / 200


@pytest.mark.parametrize(
    "times",
    [lambda t: 0 * t, lambda t: np.floor(t), lambda t: np.where(t > 1, t + 20, t), lambda t: 3 * (t / 3) ** 0.25],
    ids=["none", "duplicate", "pause", "slow start"],
)
def test_odd_times_do_no_harm(times):
    assert off(fit(changed(sketches(), 0, times=times), density=QUICK)) < 0.02


def test_a_slip_of_the_pen_is_left_out_and_said():
    skill = fit(changed(sketches(count=3), 0, dot, only=1), density=QUICK)
    assert any("Stroke 2 on view v0" in sentence and "slip of the pen" in sentence for sentence in skill.report["warnings"])
    assert off(skill) < 0.01
    kept, notes = without_slips(sketches())
    assert notes == [] and [len(sketch.strokes) for sketch in kept] == [2, 2]


def test_a_view_on_which_there_is_but_a_dot_is_told():
    warnings = fit(changed(sketches(), 0, dot), density=QUICK).report["warnings"]
    assert any("What is drawn on view v0 is only" in sentence for sentence in warnings)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_line_straight_at_a_camera_is_learned_from_the_other(noise):
    toward = (TARGET - CAMERAS[0].centre) / np.linalg.norm(TARGET - CAMERAS[0].centre)
    line = TARGET + 0.4 * (S[:, None] - 0.5) * toward
    skill = fit(sketches(line, noise=noise), density=QUICK)
    assert off(skill, line) < 0.02 and len(skill.routes) == 0


def test_what_is_drawn_off_the_picture_is_refused():
    with pytest.raises(SketchError, match="'v0' lies outside its 640x480 picture|never cross well"):
        fit(changed(sketches(), 0, lambda x: x + [3000, 0]), density=QUICK)


def test_a_motion_behind_one_of_three_cameras_contradicts():
    drawn = sketches(cameras=CAMERAS)
    drawn[1] = replace(drawn[1], camera=turned(drawn[1].camera))
    skill = fit(drawn, density=QUICK)
    assert skill.report["contradicting"] == {"v1": None} and off(skill) < 0.02


@pytest.mark.parametrize("size", [1e3, 1e-3])
def test_the_unit_of_the_world_does_not_matter(size):
    scale = np.diag([size, size, size, 1.0])
    drawn = [replace(sketch, camera=sketch.camera.moved(scale)) for sketch in sketches()]
    assert off(fit(drawn, density=QUICK), size * reach(np.linspace(0, 1, 1000))) < 0.02 * size


@pytest.mark.parametrize("seed", range(3))
def test_scribbles_give_finite_numbers_and_a_warning_or_an_error(seed):
    rng = np.random.default_rng(seed)
    drawn = []
    for v, camera in enumerate(CAMERAS[:2]):
        lines = [rng.uniform(0, 480, (int(rng.integers(3, 60)), 2)) for _ in range(2)]
        drawn.append(Sketch(f"v{v}", camera, tuple(Stroke(x, np.arange(len(x))) for x in lines)))
    try:
        skill = fit(drawn, density=QUICK)
    except SketchError:
        return
    assert np.isfinite(skill.distribution.mean_at(S)).all() and skill.report["warnings"]
