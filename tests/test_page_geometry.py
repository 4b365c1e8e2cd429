"""The page's maths in Node against scene/camera.py, and its files by size."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from scene.camera import Camera, look_at
from teach.epipolar import fundamental, sampson

ROOT = Path(__file__).parents[1]
STATIC = ROOT / "teach" / "page" / "static"


def plain(camera: Camera) -> dict:
    return {"K": camera.K.tolist(), "world_from_camera": camera.world_from_camera.tolist(), "width": camera.width, "height": camera.height}


def case(rng) -> dict:
    eyes = rng.uniform(-1, 1, (2, 3)) + [[2.0, 0.5, 1.5], [0.3, -2.0, 1.0]]
    K = [np.array([[f, 0, 320 + rng.normal(0, 9)], [0, 1.02 * f, 240], [0, 0, 1]]) for f in rng.uniform(400, 900, 2)]
    a, b = (Camera(k, look_at(eye, rng.normal(0, 0.1, 3)), 640, 480) for k, eye in zip(K, eyes, strict=True))
    points = rng.uniform(-0.4, 0.4, (8, 3))
    pixels, others = a.project(points), b.project(points) + rng.normal(0, 8, (8, 2))
    t = np.linspace(0, 1, 120)[:, None]
    root = rng.normal(size=(3, 3)) * 0.02
    J = a.jacobian(points[0])
    place = {"azimuth": float(rng.uniform(-3, 3)), "elevation": float(rng.uniform(-0.5, 1.2)), "distance": 2.5}
    eye = 2.5 * np.array([np.cos(place["azimuth"]) * np.cos(place["elevation"]), np.sin(place["azimuth"]) * np.cos(place["elevation"]), np.sin(place["elevation"])])
    values = {
        "a": plain(a), "b": plain(b), "points": points, "pixels": pixels, "others": others, "directions": a.rays(pixels)[1],
        "jacobians": a.jacobian(points), "F": fundamental(a, b), "sampson": sampson(pixels, others, fundamental(a, b)),
        "behind": a.centre - a.forward, "covariance": root @ root.T, "seen": J @ root @ root.T @ J.T,
        "target": np.full(3, 0.1), "place": place, "orbit": look_at(eye + 0.1, np.full(3, 0.1)),
        "curve": np.hstack([0.5 * t - 0.2, 0.3 * np.sin(3 * t), 0.3 * t * (1 - t) + 0.05 * np.cos(9 * t)]),
    }  # fmt: skip
    return values


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node on this machine")
def test_the_pages_maths_is_that_of_the_cameras(tmp_path):
    rng = np.random.default_rng(0)
    cases = tmp_path / "cases.json"
    cases.write_text(json.dumps([case(rng) for _ in range(6)], default=lambda array: array.tolist()))
    module = tmp_path / "geometry.mjs"
    module.write_text((STATIC / "geometry.js").read_text())
    environment = os.environ | {"CASES": str(cases), "GEOMETRY": module.as_uri()}
    ran = subprocess.run(["node", "--test", ROOT / "tests" / "page" / "geometry.mjs"], capture_output=True, text=True, env=environment)
    assert ran.returncode == 0, ran.stdout[-4000:]


def test_all_modules_are_asked_for_at_once():
    start = (STATIC / "index.html").read_text()
    for path in STATIC.glob("*.js"):
        assert f'href="/static/{path.name}"' in start or path.name == "page.js"


def test_the_page_is_small_and_needs_no_network():
    files = [path for path in STATIC.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 2**20
    for path in files:
        foreign = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in foreign and "https://" not in foreign, path.name
