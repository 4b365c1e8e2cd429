"""Two points with a known distance give metres; gravity, an origin and a direction give the rest."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from similarities import random_similarity, unscaled

from scene.camera import Camera, look_at
from scene.colmap import straighten
from scene.frame import distance
from scene.frame.distance import Ruler
from scene.model import Model, ReconstructionFailed

A, B = np.array([0.3, -0.4, 0.0]), np.array([0.9, 0.4, 0.0])
ORIGIN, FORWARD = np.array([0.25, 0.1, 0.02]), np.array([0.85, 0.1, 0.15])
NAMES = [f"{i:04d}" for i in range(16)]


def cameras():
    angles = np.linspace(0, 5, len(NAMES))
    eyes = [(0.6 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0.9 + 0.2 * np.sin(3 * a)) for a in angles]
    return [Camera.from_fov(look_at(eye, (0.6, 0, 0)), 640, 480, 50) for eye in eyes]


def table(count=400):
    rng = np.random.default_rng(0)
    return np.concatenate([rng.uniform([0, -0.6, 0], [1.2, 0.6, 0], (count, 3)), rng.uniform([0.4, -0.2, 0.1], [0.8, 0.2, 0.3], (100, 3))])


def clicks(point, rng, px=0.0, count=8):
    return {NAMES[i]: cameras()[i].project(point) + rng.normal(0, px, 2) for i in rng.choice(len(NAMES), count, replace=False)}


def ruler(rng, px=0.0, mm=0.0, count=8, **changed):
    ends = {"start": clicks(A, rng, px, count), "end": clicks(B, rng, px, count)}
    place = {"origin": clicks(ORIGIN, rng, px, count), "forward": clicks(FORWARD, rng, px, count), "origin_in_base": ORIGIN}
    return Ruler(**{"distance": 1.0 + rng.normal(0, mm / 1000)} | ends | place | changed)


def fit(given, true, points=None):
    seen = unscaled(true, cameras())
    points = np.linalg.solve(true.matrix, np.c_[table(), np.ones(500)].T).T[:, :3] if points is None else points
    return distance.fit_frame(given, NAMES, seen, points, np.full(len(points), 0.5)), seen


def errors_mm(found, seen):
    return np.array([1000 * np.linalg.norm(found.move(c).centre - t.centre) for c, t in zip(seen, cameras())])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_exact_pixels_return_the_exact_frame(seed):
    true = random_similarity(seed)
    found, _ = fit(ruler(np.random.default_rng(seed)), true)
    assert np.allclose(found.matrix, true.matrix, atol=1e-5 * true.scale)
    assert found.frame == "robot base" and found.residual_mm < 1e-3 and not found.warnings


@pytest.mark.parametrize("seed", range(6))
def test_half_a_pixel_and_half_a_millimetre_leave_the_cameras_within_five_millimetres(seed):
    found, seen = fit(ruler(np.random.default_rng(seed), 0.5, 0.5), random_similarity(seed))
    assert errors_mm(found, seen).max() < 5 and 0.5 < found.residual_mm < 3


def test_the_told_uncertainty_is_the_error_that_noise_makes():
    squares, told = [], []
    for seed in range(60):
        found, seen = fit(ruler(np.random.default_rng(seed), 1.0, 0.5), random_similarity(1))
        squares.append(np.mean(errors_mm(found, seen) ** 2))
        told.append(found.uncertainty_mm)
    assert np.mean(told) == pytest.approx(np.sqrt(np.mean(squares)), rel=0.3)


def test_a_click_on_the_wrong_thing_is_left_out_and_named():
    given = ruler(np.random.default_rng(0), 0.3)
    wrong = next(iter(given.start))
    given.start[wrong] = given.start[wrong] + [30, -20]
    found, seen = fit(given, random_similarity(2))
    assert f"{wrong} of from" in found.warnings[0] and errors_mm(found, seen).max() < 5


def test_without_origin_and_direction_the_frame_is_level_and_in_metres_and_says_what_is_missing():
    true = random_similarity(3)
    found, seen = fit(ruler(np.random.default_rng(0), origin=None, forward=None), true)
    assert found.frame == "level" and found.describe()["unit"] == "m" and "origin" in found.warnings[0]
    assert found.scale == pytest.approx(true.scale) and (found.rotation @ true.rotation.T)[2, 2] == pytest.approx(1)
    found, _ = fit(ruler(np.random.default_rng(0), forward=None), true)
    assert found.frame == "level" and np.allclose(found.apply(np.linalg.solve(true.matrix, [*ORIGIN, 1])[:3]), ORIGIN)


def test_points_of_the_model_serve_as_well_as_pixels():
    true, points = random_similarity(4), np.concatenate([[A, B], table()])
    in_model = np.linalg.solve(true.matrix, np.c_[points, np.ones(len(points))].T).T[:, :3]
    found, _ = fit(ruler(np.random.default_rng(0), start=0, end=1), true, in_model)
    assert np.allclose(found.matrix, true.matrix, atol=1e-5 * true.scale)
    with pytest.raises(ValueError, match="no point 9999"):
        fit(ruler(np.random.default_rng(0), start=9999), true)


def test_a_short_distance_is_said_to_be_unsure_and_a_tiny_one_refused():
    rng = np.random.default_rng(0)
    near, tiny = A + [0.1, 0, 0], A + [0.004, 0, 0]
    found, _ = fit(ruler(rng, 0.5, distance=0.1, end=clicks(near, rng, 0.5)), random_similarity(5))
    assert found.uncertainty_mm > 5 and "may be off" in found.warnings[0]
    with pytest.raises(ReconstructionFailed, match="4 mm between two points"):
        fit(ruler(rng, 0.5, distance=0.004, end=clicks(tiny, rng, 0.5)), random_similarity(5))


def test_what_gives_no_frame_is_refused():
    rng, true = np.random.default_rng(0), random_similarity(6)
    with pytest.raises(ReconstructionFailed, match="same point|leaves the frame open"):
        fit(ruler(rng, end=clicks(A, rng)), true)
    with pytest.raises(ReconstructionFailed, match="straight above"):
        fit(ruler(rng, forward=clicks(ORIGIN + [0, 0, 0.2], rng)), true)
    with pytest.raises(ReconstructionFailed, match="from: the pixels of .* do not belong to one point"):
        fit(ruler(rng, start={n: cameras()[i].project(A) + [0, dv] for i, n, dv in ((0, NAMES[0], 80), (3, NAMES[3], -80))}), true)


# The file


def content():
    pixels = {"pixels": {"0000.jpg": [1, 2], "0001": [3.5, 4]}}
    return {"distance": 0.5, "from": pixels, "to": {"point": 7}, "origin": pixels, "origin_in_base": [1, 2, 3]}


def test_the_file_is_read_by_the_photographs_names(tmp_path):
    (tmp_path / "d.json").write_text(json.dumps(content()))
    read = Ruler.load(tmp_path / "d.json")
    assert list(read.start) == ["0000", "0001"] and read.end == 7 and read.forward is None
    assert read.origin_in_base.tolist() == [1, 2, 3]


@pytest.mark.parametrize(("change", "message"), [
    ({"distance": 0}, "positive length"), ({"distance": "a"}, "d.json"), ({"from": {"pixels": {"0000": [1, 2]}}}, "two photographs"),
    ({"from": {"pixels": {"0": [1], "1": [1, 2]}}}, "from: a place"), ({"to": {"point": -1}}, "to: a place"), ({"to": 3}, "d.json"),
    ({"ends": 1}, "unknown ends"), ({"origin_in_base": [1]}, "three numbers"), ({"to": {"point": 1.5}}, "to: a place"),
])  # fmt: skip
def test_a_broken_file_says_what_is_wrong(tmp_path, change, message):
    (tmp_path / "d.json").write_text(json.dumps(content() | change))
    with pytest.raises(ValueError, match=message):
        Ruler.load(tmp_path / "d.json")


def test_a_direction_needs_an_origin_and_a_file_its_ends(tmp_path):
    given = content()
    given["forward"] = given.pop("origin")
    (tmp_path / "d.json").write_text(json.dumps(given))
    with pytest.raises(ValueError, match="needs an origin"):
        Ruler.load(tmp_path / "d.json")
    (tmp_path / "d.json").write_text("{}")
    with pytest.raises(ValueError, match="missing from"):
        Ruler.load(tmp_path / "d.json")
    with pytest.raises(FileNotFoundError, match="no such file of a distance"):
        Ruler.load(tmp_path / "none.json")


# Pixels of photographs as they were taken


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """A COLMAP model of three photographs of 1280x960 through a lens that bends, and what it sees of a grid of points."""
    folder = tmp_path_factory.mktemp("bent")
    code = """
import zlib, numpy, pycolmap, json, sys
camera = pycolmap.Camera(camera_id=1, model="SIMPLE_RADIAL", width=1280, height=960, params=[1100, 640, 480, -0.12])
model = pycolmap.Reconstruction()
model.add_camera_with_trivial_rig(camera)
for i in range(3):
    image = pycolmap.Image(name=f"sub {i}.jpg", camera_id=1, image_id=i + 1)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
model.write(sys.argv[1])
rays = numpy.stack(numpy.meshgrid([-.4, 0, .4], [-.3, 0, .3]), -1).reshape(-1, 2)
print(json.dumps([rays.tolist(), numpy.asarray(camera.img_from_cam(numpy.c_[rays, numpy.ones(9)])).tolist()]))
"""
    printed = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True)
    assert printed.returncode == 0, printed.stderr
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    none = np.zeros((0, 3))
    names = ("sub 0", "sub 1", "sub 2")
    model = Model(names, (Camera(K, np.eye(4), 640, 480),) * 3, (), none, none, none, 4, 0.5, ("gone",), folder)
    return model, *(np.array(part) for part in json.loads(printed.stdout))


def test_pixels_are_freed_of_the_lens_and_brought_to_the_size_of_the_undistorted_pictures(bent):
    model, rays, pixels = bent
    found = straighten(model, {"sub 1": pixels})
    assert np.abs(found["sub 1"] - (500 * rays + [320, 240])).max() < 0.01
    assert np.abs(pixels / 2 - found["sub 1"]).max() > 5, "the lens does bend"


def test_pixels_of_no_photograph_or_outside_of_it_are_refused(bent):
    model, *_ = bent
    with pytest.raises(ValueError, match="no photograph gone .left out by COLMAP"):
        straighten(model, {"gone": [[1, 2]]})
    with pytest.raises(ValueError, match="sub 0 has no pixel.*1280x960"):
        straighten(model, {"sub 0": [[1500, 20]]})
    with pytest.raises(ReconstructionFailed, match="cannot be read"):
        straighten(Model(**{**vars(model), "sparse": Path("nowhere")}), {"sub 0": [[1, 2]]})
