"""The page as a stage of the job: it waits for the person, and leaves everything saved."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from conf.page import planned, scene_of
from robot.planner import Plan
from scene.camera import Camera, View, look_at
from scene.dataset import load_cameras, load_views, save_views
from scene.views import depth_path
from teach.sketch import Sketch, Stroke, dumps, load

ROOT = Path(__file__).parents[1]
CAMERAS = [Camera.from_fov(look_at(eye, [0, 0, 0.1]), 64, 48, 50) for eye in ([1.0, 0.7, 0.8], [0.9, -0.8, 0.9], [0.4, 0.0, 1.5])]


@pytest.fixture
def capture(tmp_path) -> Path:
    views = [View(f"view{k}", camera, np.full((48, 64, 3), 90, np.uint8)) for k, camera in enumerate(CAMERAS)]
    save_views(tmp_path / "data", [View(f"photo{k}", view.camera, view.image) for k, view in enumerate(views)], points=np.zeros((4, 3)))
    save_views(tmp_path / "data" / "views", views, images=".")
    (tmp_path / "data" / ".stages").mkdir()
    (tmp_path / "data" / ".stages" / "render.json").write_text(json.dumps({"hash": "x", "metrics": {}, "seconds": 0}))
    return tmp_path / "data"


@pytest.fixture
def opened(capture, tmp_path):
    """The running job and the address that it printed."""
    command = [sys.executable, "-m", "teach.draw", f"data={capture}", "user.port=0", f"hydra.run.dir={tmp_path}/runs/default/now/0"]
    job = subprocess.Popen(command, cwd=tmp_path, stdout=(tmp_path / "log").open("w"), stderr=subprocess.STDOUT, env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"})
    for _ in range(900):
        if found := re.search(r"draw at (http://\S+/)\s", (tmp_path / "log").read_text()):
            break
        time.sleep(0.1)
    yield job, found[1]
    job.kill()
    job.wait()


def send(address: str, method: str, body: str, **headers) -> dict:
    request = urllib.request.Request(address, body.encode(), {"content-type": "application/json", **headers}, method=method)
    for _ in range(50):
        try:
            return json.loads(urllib.request.urlopen(request, timeout=30).read())
        except urllib.error.HTTPError as error:
            return json.loads(error.read())
        except OSError:
            time.sleep(0.1)


def drawing(count: int) -> str:
    t = np.linspace(0, 1, 20)
    curve = np.column_stack([0.1 * np.sin(3 * t), 0.3 * t - 0.15, 0.05 + 0.3 * t * (1 - t)])
    return dumps([Sketch(f"view{k}", CAMERAS[k], [Stroke(CAMERAS[k].project(curve), t)]) for k in range(count)])


def test_the_job_goes_on_with_the_skill_that_the_person_is_done_with(opened, capture, tmp_path):
    job, address = opened
    about = send(f"{address}api/scene", "GET", "")
    assert [view["name"] for view in about["views"]] == ["view0", "view1", "view2", "photo0", "photo1", "photo2"]
    assert about["can"] == {"fit": True, "render": False, "suggest": False, "plan": True, "perform": True, "body": True, "finish": True, "mesh": False}
    first = send(f"{address}api/skills/reach", "PUT", drawing(1), **{"if-none-match": "*"})
    assert "two views" in send(f"{address}api/skills/reach/done", "POST", '{"tab": "t"}')["error"]
    send(f"{address}api/skills/reach", "PUT", drawing(2), **{"if-match": first["revision"]})
    assert send(f"{address}api/skills/reach/done", "POST", '{"tab": "t"}') == {"done": "reach"}
    assert job.wait(60) == 0
    assert [sketch.view for sketch in load(tmp_path / "runs" / "default" / "now" / "0" / "sketches.json")] == ["view0", "view1"]


@pytest.mark.slow
def test_ctrl_c_leaves_everything_saved(opened, capture, tmp_path):
    job, address = opened
    send(f"{address}api/skills/reach", "PUT", drawing(2), **{"if-none-match": "*"})
    job.send_signal(signal.SIGINT)
    assert job.wait(60) == 130
    assert "Traceback" not in (tmp_path / "log").read_text()
    assert (capture / "sketches" / "reach.json").read_text() == drawing(2)


def test_cameras_are_read_without_their_pictures(capture):
    cameras = load_cameras(capture)
    assert [path.stem for path in cameras] == ["photo0", "photo1", "photo2"]
    for view, (path, camera) in zip(load_views(capture), cameras.items(), strict=True):
        assert path.stem == view.name and np.allclose(camera.projection, view.camera.projection)


def test_a_scene_known_from_truth_has_its_views_and_shows_what_their_depth_pictures_see(capture):
    (capture / "transforms.json").unlink()
    for k, camera in enumerate(CAMERAS):
        origin, direction = camera.rays(camera.pixel_centres())
        far = (0.1 - origin[..., 2]) / direction[..., 2]  # a floor 10 cm up
        np.save(depth_path(capture / "views", f"view{k}"), np.where(far > 0, far * (direction @ camera.forward), np.nan).astype(np.float32))
    scene = scene_of(SimpleNamespace(capture=capture))
    assert list(scene.views) == ["view0", "view1", "view2"] and len(scene.points) == 0 and scene.surfaces == ("view0", "view1", "view2")
    np.testing.assert_allclose(scene.target, [0, 0, 0.1], atol=1e-6)  # at which all of them look
    solid = scene.mesh()
    assert len(solid.faces) > 1000 and np.abs(solid.vertices[:, 2] - 0.1).max() < 1e-3


def test_a_plan_is_red_where_it_touches_and_where_it_strays():
    n = 50
    clearance, error = np.full(n, 0.05), np.zeros(n)
    clearance[10:20], error[30:35] = -0.002, 0.01
    plan = Plan(np.linspace(0, 2, n), np.zeros((n, 7)), tuple("abcdefg"), error, clearance, np.full(n, 0.1), np.zeros((n, 3)), ("the mean: touches",), 1, 0, False)
    shown = planned(plan)
    assert np.flatnonzero(shown["touches"]).tolist() == list(range(10, 20))
    assert np.flatnonzero(shown["strays"]).tolist() == list(range(30, 35))
    assert shown["least_mm"] == -2.0 and not shown["feasible"] and "touches" in shown["sentence"]
    json.dumps(shown, allow_nan=False)
