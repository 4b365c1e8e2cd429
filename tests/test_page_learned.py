"""What the page shows is what was learned, and outlines that bound nothing yet do not hide it."""

import json
from functools import partial

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.density import GaussianTube
from teach.page.learned import TIMES, learn
from teach.rptl import fit
from teach.sketch import Sketch, SketchError, Stroke, dumps
from teach.trajectory import Skill

CAMERAS = [Camera.from_fov(look_at(eye, [0, 0, 0.1]), 640, 480, 50) for eye in ([1.0, 0.7, 0.8], [0.9, -0.8, 0.9])]


def drawn(*more) -> str:
    t = np.linspace(0, 1, 40)
    curve = np.column_stack([0.1 * np.sin(3 * t), 0.5 * t - 0.25, 0.05 + 0.5 * t * (1 - t)])
    sketches = [Sketch(f"view{k}", camera, [Stroke(camera.project(curve), 2 * t)]) for k, camera in enumerate(CAMERAS)]
    return dumps([Sketch(s.view, s.camera, s.strokes + tuple(more) * (s.view == "view0")) for s in sketches])


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    folder, heard = tmp_path_factory.mktemp("learned"), []
    circle = np.linspace(0, 6, 30)
    outline = Stroke(np.column_stack([300 + 60 * np.cos(circle), 200 + 60 * np.sin(circle)]), circle, kind="keep_out")
    (folder / "reach.json").write_text(drawn(outline))
    shown = learn(partial(fit, density=GaussianTube()), lambda *words: heard.append(words), folder / "reach.json", folder / "reach.npz")
    return shown, Skill.load(folder / "reach.npz"), heard


def test_the_mean_and_its_covariance_are_the_skills(learned):
    shown, skill, heard = learned
    (way,) = shown["ways"]
    assert np.abs(way["mean"] - skill.distribution.mean_at(TIMES)).max() < 1e-5
    expected = skill.distribution.covariance_at(TIMES).reshape(-1, 9)
    assert np.abs(np.array(way["covariance"]) - expected).max() < 1e-3 * np.abs(expected).max()
    assert np.array(way["samples"]).shape == (14, len(TIMES), 3) and shown["sentence"] == skill.report["sentence"]
    assert [share for share, _ in heard] == sorted(share for share, _ in heard) and len(heard) == 4
    json.dumps(shown, allow_nan=False)


def test_a_region_outlined_on_one_view_only_is_said_not_to_count_yet(learned):
    shown, skill, _ = learned
    assert "only on view 'view0'" in shown["warnings"][0] and shown["regions"] == [] and skill.keep_out == ()


def test_what_cannot_be_seen_in_3d_is_refused(tmp_path):
    document = json.loads(drawn())
    document["sketches"] = document["sketches"][:1]
    (tmp_path / "flat.json").write_text(json.dumps(document))
    with pytest.raises(SketchError, match="two views"):
        learn(fit, lambda *words: None, tmp_path / "flat.json", tmp_path / "flat.npz")
    assert not (tmp_path / "flat.npz").exists()
