"""The 3D view's surfaces: thinned, packed, drawn as the cameras see them; and the arm's own."""

import base64
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conf.body import CLOSING, body, fingers, link_rows
from robot.arm import Arm
from scene.camera import Camera, look_at
from teach.page.solid import packed, relief, thinned
from teach.sketch import Event

ROOT = Path(__file__).parents[1]
STATIC = ROOT / "teach" / "page" / "static"


def plane(n: int):
    """A square of n x n vertices, red on one half and blue on the other."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij"))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.column_stack([corner, corner + n, corner + n + 1]), np.column_stack([corner, corner + n + 1, corner + 1])])
    colours = np.where((x < 0.5)[:, None], [255, 0, 0], [0, 0, 255]).astype(np.uint8)
    return np.column_stack([x, y, np.full(n * n, 0.3)]), faces, colours


def area(vertices, faces) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_a_thinned_surface_keeps_its_place_its_colours_and_most_of_its_area():
    vertices, faces, colours = plane(60)
    solid = thinned(vertices, faces, colours, most=500)
    assert 250 < len(solid.vertices) <= 500
    np.testing.assert_allclose(solid.vertices[:, 2], 0.3)
    assert 0.85 < area(solid.vertices, solid.faces) <= 1.0
    np.testing.assert_array_equal(solid.colours[solid.vertices[:, 0] < 0.4], np.tile([255, 0, 0], ((solid.vertices[:, 0] < 0.4).sum(), 1)))
    assert (np.diff(np.sort(solid.faces, axis=1), axis=1) > 0).all()
    same = thinned(vertices, faces, colours)
    np.testing.assert_array_equal(same.vertices, vertices)


def test_a_surface_of_more_vertices_than_can_be_numbered_is_not_packed():
    with pytest.raises(ValueError, match="thin the mesh first"):
        packed(thinned(*plane(300), most=90_000))


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node on this machine")
def test_the_page_draws_surfaces_where_the_cameras_see_them(tmp_path):
    rng, camera = np.random.default_rng(0), Camera.from_fov(look_at([1.0, 0.6, 0.8], [0, 0, 0]), 160, 120, 50)
    triangle = np.array([[-0.3, -0.2, 0.0], [0.35, -0.1, 0.05], [0.0, 0.3, -0.1]])
    towards = lambda share: camera.centre + share * (triangle - camera.centre)
    pose = np.concatenate([rng.normal(0, 0.05, 3), Rotation.random(random_state=0).as_quat()])
    solid = thinned(*plane(9))
    hits = [[int(x), int(y), depth_of(camera, triangle, x + 0.5, y + 0.5)] for x, y in rng.integers([0, 0], [160, 120], (300, 2))]
    case = {
        "camera": camera.plain(), "packed": base64.b64encode(packed(solid)).decode(), "vertices": solid.vertices, "faces": solid.faces, "colours": solid.colours,
        "step": 2.0 / 65535, "triangle": triangle, "nearer": towards(0.6), "farther": towards(1.4), "hits": hits, "pose": pose,
        "moved": triangle @ Rotation.from_quat(pose[3:]).as_matrix().T + pose[:3],
    }  # fmt: skip
    (tmp_path / "cases.json").write_text(json.dumps(case, default=lambda array: array.tolist()))
    module = tmp_path / "raster.mjs"
    module.write_text((STATIC / "raster.js").read_text())
    environment = os.environ | {"CASES": str(tmp_path / "cases.json"), "RASTER": module.as_uri()}
    ran = subprocess.run(["node", "--test", ROOT / "tests" / "page" / "raster.mjs"], capture_output=True, text=True, env=environment)
    assert ran.returncode == 0, ran.stdout[-4000:]


def depth_of(camera, triangle, u, v) -> float:
    """Depth [m] along the optical axis at which the ray of a pixel meets a triangle, 0 where it passes by."""
    origin, direction = camera.rays(np.array([u, v]))
    shares = np.linalg.solve(np.column_stack([triangle[1] - triangle[0], triangle[2] - triangle[0], -direction]), origin - triangle[0])
    met = min(shares[0], shares[1], 1 - shares[0] - shares[1]) > 0 and shares[2] > 0
    return float(shares[2] * direction @ camera.forward) if met else 0.0


@pytest.mark.parametrize("name", ["panda", "z1"])
def test_the_arms_links_are_where_its_kinematics_has_them(name):
    arm = Arm.load(name)
    shown, q = body(arm), arm.random(3, seed=0)
    rows = np.array(link_rows(arm, [0.0, 1.0, 2.0], q))
    assert rows.shape == (3, len(shown["links"]), 7) and len(shown["home"]) == len(shown["links"])
    for k, link in enumerate(shown["links"]):
        pose = arm.link_poses(q)[1, arm.link_names.index(link["name"])]
        vertices = np.array(link["vertices"])
        placed = vertices @ Rotation.from_quat(rows[1, k, 3:]).as_matrix().T + rows[1, k, :3]
        np.testing.assert_allclose(placed, vertices @ pose[:3, :3].T + pose[:3, 3], atol=3e-4)
        assert np.max(link["faces"]) < len(vertices)
    assert len(json.dumps(shown)) < 200_000


def test_fingers_close_and_open_at_their_events_and_a_walking_robots_feet_stand_on_the_floor():
    arm, times = Arm.load("aliengo_z1"), np.linspace(0, 2, 101)
    joints = np.repeat(arm.home[None], len(times), axis=0)
    joints[:, 0] += 0.15 * times  # the trunk goes ahead
    events = [Event("gripper_open", 1.5), Event("pause", 0.2), Event("gripper_close", 0.5)]
    grip = fingers(arm.gripper, times, events)[:, 0]
    assert (grip[times <= 0.5] == arm.gripper.open).all() and (grip[(times > 0.5 + CLOSING) & (times <= 1.5)] == arm.gripper.closed).all()
    assert grip[-1] == arm.gripper.open and (np.abs(np.diff(grip)) < 0.1).all()
    names, rows = [link["name"] for link in body(arm)["links"]], np.array(link_rows(arm, times, joints, events))
    for foot in arm.legs.feet:
        height = rows[:, names.index(foot), 2] - arm.legs.radius - arm.legs.ground
        assert np.abs(height).min() < 1e-3 and -1e-3 < height.min() and height.max() < 0.1
    moved = Rotation.from_quat(rows[:, names.index("gripperMover"), 3:])
    assert (moved[0].inv() * moved[45]).magnitude() == pytest.approx(1.0, abs=1e-3)
    assert len(link_rows(arm, times, joints, events, rows=[0, 50, 100])) == 3


def test_what_depth_pictures_show_lies_where_it_was_seen_and_edges_are_left_open():
    camera = Camera.from_fov(look_at([0, -1, 1], [0, 0, 0]), 64, 48, 60)
    depth = np.full((48, 64), 2.0)
    depth[:, 32:] = 1.0
    depth[:4] = np.nan
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, 32:] = 200
    solid = relief([(camera, image, depth)] * 2, most=1200)
    assert 500 < len(solid.vertices) <= 1200
    far = (solid.vertices - camera.centre) @ camera.forward
    np.testing.assert_allclose(far, np.where(solid.colours[:, 0] > 0, 1.0, 2.0))
    assert np.ptp(far[solid.faces], axis=1).max() < 1e-9  # no face joins what is near to what is far
    u, v = camera.project(solid.vertices).T
    assert ((u > 32) == (far < 1.5)).all() and v.min() > 4
