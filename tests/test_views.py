"""Which cameras look at the scene, and their pictures on disk."""

from types import SimpleNamespace

import numpy as np
import pytest
from fields import Painter
from PIL import Image

from scene import views
from scene.camera import Camera, orbit
from scene.dataset import save_views
from scene.viewpoints import Proposal

TARGET = np.array([0.4, -0.2, 0.3])


def around(poses, width=640, height=480):
    return [Camera.from_fov(pose, width, height, 55) for pose in poses]


def test_two_views_to_sketch_on_are_as_far_apart_as_asked_and_the_third_far_from_both():
    chosen = views.well_separated(around(orbit(TARGET, 1.5, 0, 24)), angle_deg=75)
    directions = [(camera.centre - TARGET) / 1.5 for camera in chosen]
    angle = lambda a, b: np.degrees(np.arccos(directions[a] @ directions[b]))
    assert angle(0, 1) == pytest.approx(75)
    assert min(angle(0, 2), angle(1, 2)) > 120


def test_a_view_of_another_shape_is_cropped_and_never_stretched():
    camera, *_ = views.well_separated(around(orbit(TARGET, 1.5, 30, 12), 800, 400), width=640, height=480)
    assert camera.K[0, 0] == camera.K[1, 1]
    assert (camera.width, camera.height) == (640, 480)


def test_rendering_writes_picture_and_depth_and_goes_on_where_it_stopped(tmp_path):
    cameras = dict(zip("abc", around(orbit(TARGET, 1, 20, 3), 32, 24)))
    first, second = Painter(), Painter()
    views.render(first, {"a": cameras["a"]}, tmp_path)
    rendered = views.render(second, cameras, tmp_path)
    assert (len(first.painted), len(second.painted)) == (1, 2)
    assert [view.name for view in rendered] == list("abc") and (rendered[0].image == 7).all()
    assert np.load(tmp_path / "b_depth.npy") == pytest.approx(2.5)


def test_a_picture_without_its_depth_is_rendered_again_and_an_orbit_has_none(tmp_path):
    cameras, again = {"a": around(orbit(TARGET, 1, 20, 1), 32, 24)[0]}, Painter()
    views.render(Painter(), cameras, tmp_path, depth=False)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    views.render(again, cameras, tmp_path, depth=False)
    assert not again.painted
    views.render(again, cameras, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "a_confidence.png", "a_depth.npy"]
    (tmp_path / "a_confidence.png").unlink()
    views.render(again, cameras, tmp_path)
    assert len(again.painted) == 2 and views.is_whole(tmp_path, "a")


def test_depth_is_found_by_a_views_name_if_its_camera_is_the_same(tmp_path):
    cameras = dict(zip("ab", around(orbit(TARGET, 1, 20, 3), 32, 24)))
    assert views.load_depths(tmp_path, cameras) == {}
    save_views(tmp_path, views.render(Painter(), cameras, tmp_path), images=".")
    (tmp_path / "b_depth.npy").unlink()
    found = views.load_depths(tmp_path, cameras | {"c": cameras["a"]})
    assert list(found) == ["a"] and found["a"] == pytest.approx(2.5) and found["a"].dtype == np.float32
    assert list(views.load_depths(tmp_path, {"a": cameras["a"].resized(64, 48)})) == ["a"]
    assert views.load_depths(tmp_path, {"a": cameras["b"]}) == {}


def test_depth_of_less_confidence_than_asked_is_none_and_the_confidence_beside_it_is_read(tmp_path):
    cameras = {"a": around(orbit(TARGET, 1, 20, 1), 32, 24)[0]}
    save_views(tmp_path, views.render(Painter(passes=0.9), cameras, tmp_path), images=".")
    with Image.open(tmp_path / "a_confidence.png") as stored:
        assert stored.mode == "L" and stored.size == (32, 24)
    sure = views.load_confidences(tmp_path, cameras)["a"]
    assert sure.dtype == np.float32 and (sure[:, :16] == 1).all()
    assert sure[:, 16:] == pytest.approx(0.5 / 0.9 - 0.5 * 0.9, abs=0.5 / 255)
    depth = views.load_depths(tmp_path, cameras, sure=0.3)["a"]
    assert depth.dtype == np.float32 and (depth[:, :16] == 2.5).all() and np.isnan(depth[:, 16:]).all()
    assert (views.load_depths(tmp_path, cameras)["a"] == 2.5).all()


def test_depth_without_a_confidence_is_sure_and_with_that_of_another_picture_refused(tmp_path):
    cameras = {"a": around(orbit(TARGET, 1, 20, 1), 32, 24)[0]}
    save_views(tmp_path, views.render(Painter(passes=1.0), cameras, tmp_path), images=".")
    Image.new("L", (16, 12)).save(tmp_path / "a_confidence.png")
    with pytest.raises(ValueError, match="render the view again"):
        views.load_depths(tmp_path, cameras)
    (tmp_path / "a_confidence.png").unlink()
    assert views.load_confidences(tmp_path, cameras) == {}
    assert (views.load_depths(tmp_path, cameras)["a"] == 2.5).all()


def proposing(calls):
    """Stands for `scene.viewpoints.suggest`: proposes the photographs in turn, and remembers what it was told."""

    def suggest(photographed, drawn=(), strokes=(), **known):
        calls.append((len(drawn), len(strokes), known))
        cameras = photographed[len(drawn) : len(drawn) + 1] if drawn else photographed[:2]
        return Proposal(tuple(cameras), (0,), 9.0, 1.0, f"after {len(drawn)}")

    return suggest


def test_a_suggested_pair_has_a_third_view_for_evaluation():
    calls, photographed = [], around(orbit(TARGET, 1.5, 30, 5))
    chosen = views.choose(photographed, suggest=proposing(calls), field="field", workspace="box", orbit=0)
    assert list(chosen.sketch.values()) == photographed[:3] and list(chosen.sketch) == ["view1", "view2", "view3"]
    assert chosen.why == ("after 0", "after 2")
    assert [call[:2] for call in calls] == [(0, 0), (2, 0)]
    assert calls[0][2] == {"field": "field", "workspace": "box", "width": 640, "height": 480}


def test_what_was_sketched_stays_and_the_next_view_joins_it():
    calls, photographed = [], around(orbit(TARGET, 1.5, 30, 5))
    stroke = SimpleNamespace(points=np.zeros((2, 2)))
    drawn = [SimpleNamespace(view=name, camera=photographed[4], motions=(stroke,)) for name in ("view1", "view3")]
    chosen = views.choose(photographed, suggest=proposing(calls), sketch=drawn, orbit=0)
    assert list(chosen.sketch) == ["view1", "view3", "view4"] and chosen.sketch["view4"] is photographed[2]
    assert calls[0][:2] == (2, 2)


def test_views_around_span_what_is_asked_at_one_height_and_distance():
    eyes = [{"eye": [-1.0, 0.9, 1.2], "target": [0.5, 0, 0.3]}, {"eye": [-1.0, -0.9, 1.2], "target": [0.5, 0, 0.3]}]
    cameras = list(views.around([], eyes, count=4, span_deg=90, elevation_deg=30, radius=1.5).sketch.values())
    offsets = np.array([camera.centre for camera in cameras]) - [0.5, 0, 0.3]
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), 1.5)
    np.testing.assert_allclose(offsets[:, 2], 0.75)
    np.testing.assert_allclose(np.diff(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360), 30)
    assert np.degrees(np.arctan2(*offsets.mean(0)[1::-1])) % 360 == pytest.approx(180)
    with pytest.raises(ValueError, match="sketch_views"):
        views.around([], None)
