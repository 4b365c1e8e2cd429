import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.basis import SquaredExponential
from teach.likelihood import projection
from teach.quality import TIMES, contradictions, level, quality, warnings
from teach.sketch import Sketch, Stroke
from teach.trajectory import TrajectoryDistribution

TARGET = np.array([0.5, 0.0, 0.4])
EYES = ((-0.3, -0.9, 0.4), (1.4, -0.9, 0.4))
CAMERAS = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 55) for eye in EYES]
BASIS, T = SquaredExponential(20, 50.0), np.linspace(0, 1, 100)
X = TARGET + np.stack([0.3 * T - 0.15, 0 * T, 0.1 * np.sin(3 * T)], axis=1)
MEAN = projection(BASIS, T, np.ones(100), 1e-10) @ X
HIGH = X + [0, 0, 0.3]
SKETCHES = [Sketch(f"v{i}", c, tuple(Stroke(c.project(X) + k, T) for k in (-2, 0, 2))) for i, c in enumerate(CAMERAS)]
CALM = {"v0": 0.0, "v1": 0.0}
"""Spread [px] of a single stroke a view."""


def assessed(uncertainty, bulge=0.0):
    """bulge: how far [px] the strokes of the second view leave the motion's picture in the middle."""
    d = TrajectoryDistribution(BASIS, MEAN, 1e-6 * np.eye(60))
    strokes = [np.stack([stroke.points for stroke in sketch.motions]) for sketch in SKETCHES]
    strokes[1] = strokes[1] + bulge * np.outer(np.exp(-(((T - 0.5) / 0.1) ** 2)), [0, 1])
    return quality(SKETCHES, strokes, d, uncertainty)


def test_strokes_are_measured_against_the_motion_each_by_itself():
    report = assessed(np.tile(1e-6 * np.eye(3), (50, 1, 1)))
    assert report["stroke_px"]["v0"] == pytest.approx([2 * 2**0.5, 0, 2 * 2**0.5], abs=0.5)
    assert report["reprojection_px"]["v1"] < 0.5
    assert report["ray_angle_deg"] == pytest.approx(87, abs=3) and len(report["angle_deg"]) == 50
    assert report["deviation_mm"][25] == pytest.approx(1000 * np.sqrt(3 * 1e-6 * (BASIS(0.5)[0] ** 2).sum()), rel=0.02)


def test_an_even_fit_has_no_weak_stretch_and_says_how_well_the_motion_is_known():
    report = assessed(np.tile(4e-6 * np.eye(3), (50, 1, 1)))
    assert not report["weakest"]["clear"]
    assert report["sentence"] == "The motion is known to about 4 mm all along."


def test_the_weak_stretch_is_named_with_the_view_that_sees_what_is_uncertain():
    uncertainty = np.tile(1e-6 * np.eye(3), (50, 1, 1))
    along = CAMERAS[0].forward  # depth of the first view: the second sees it from the side
    uncertainty[20:30] += 4e-4 * np.outer(along, along)
    report = assessed(uncertainty)
    assert report["weakest"]["view"] == "v1"
    assert report["weakest"]["from"] == pytest.approx(TIMES[20]) and report["weakest"]["to"] == pytest.approx(TIMES[29])
    assert "only to 39 mm from 41% to 59% of it: draw that part once more on view v1" in report["sentence"]


def test_a_part_that_strokes_contradict_is_the_weakest_and_the_view_that_strays_is_to_be_drawn_again():
    weak = assessed(np.tile(4e-6 * np.eye(3), (50, 1, 1)), bulge=20.0)["weakest"]
    assert weak["view"] == "v1" and weak["clear"] and weak["usual_mm"] == pytest.approx(2, rel=0.2)
    assert 0.38 < weak["from"] < 0.5 < weak["to"] < 0.62
    pixel = 1 / np.linalg.norm(CAMERAS[1].jacobian(X[50:51])[0], ord=2)  # [m], the size of one at the motion
    assert weak["uncertainty_mm"] == pytest.approx(1000 * np.hypot(2e-3, 20 * pixel), rel=0.1)


def test_there_is_always_a_least_certain_stretch_with_its_view_though_not_always_a_clear_one():
    uncertainty = np.tile(4e-6 * np.eye(3), (50, 1, 1))
    uncertainty[:10] *= 1.5
    weak = assessed(uncertainty)["weakest"]
    assert not weak["clear"] and weak["from"] == 0 and weak["to"] == pytest.approx(TIMES[9]) and weak["view"] in ("v0", "v1")


def test_contradicting_views_are_named_with_how_far_they_are_off():
    out, sentences = contradictions(SKETCHES, [True, False], [2.0, 31.0])
    assert out == {"v1": 31.0} and "view v1 contradicts the others" in sentences[0] and "31 px" in sentences[0]
    assert "behind its camera" in contradictions(SKETCHES, [True, False], [2.0, np.inf])[1][0]
    assert contradictions(SKETCHES, [True, True], [2.0, 3.0]) == ({}, [])


def test_what_a_person_should_know_is_said_in_sentences():
    said = warnings(SKETCHES, HIGH, {"v0": 1.0, "v1": 40.0}, CALM, 8.0, np.array([0, 3, 4]))
    assert len(said) == 3
    assert "At 1 of 3 times" in said[0] and "8 degrees apart" in said[1] and "v1 miss the motion by 40 px" in said[2]
    assert warnings(SKETCHES, HIGH, {"v0": 1.0, "v1": 2.0}, CALM, 60.0, np.array([3])) == []


def test_a_mean_that_leaves_its_strokes_by_more_than_they_spread_is_told():
    miss = {"v0": 1.0, "v1": 15.0}
    said = warnings(SKETCHES, HIGH, miss, {"v0": 5.0, "v1": 7.0}, 60.0, np.array([3]))
    assert len(said) == 1 and "v1 miss the motion by 15 px" in said[0]
    assert warnings(SKETCHES, HIGH, miss, {"v0": 5.0, "v1": 8.0}, 60.0, np.array([3])) == []


def test_a_motion_in_one_plane_with_the_cameras_is_told():
    flat = TARGET + np.stack([0.2 * np.cos(3 * T), 0.2 * np.sin(3 * T), 0 * T], axis=1)  # at the cameras' own height
    assert level(CAMERAS, flat).all() and not level(CAMERAS, flat + np.outer(T, [0, 0, 0.4])).any()
    above = Camera.from_fov(look_at((0.5, 0.2, 2.0), TARGET, up=(1, 0, 0)), 640, 480, 55)
    assert not level([*CAMERAS, above], flat).all()  # a third view from above settles it
    said = warnings(SKETCHES, flat, {"v0": 1.0, "v1": 2.0}, CALM, 60.0, np.array([3]))
    assert len(said) == 1 and "100% of the motion runs in one plane with the cameras" in said[0]
