import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from robot.world import World
from scene.camera import Camera, look_at
from scene.dataset import save_image
from scene.frame.apriltag import TagLayout
from scene.model import ReconstructionFailed
from scene.resection import resect
from scene.resection.pnp import solve

SIZE = (640, 480)


def layout(heights=(0.0, 0.0, 0.0, 0.0)):
    places = np.column_stack([[(0.4, -0.3), (0.9, -0.3), (0.9, 0.3), (0.4, 0.3)], heights])
    poses = {n: np.eye(4) for n in range(4)}
    for n, place in enumerate(places):
        poses[n][:3, 3] = place
    return TagLayout(0.1, poses)


def camera(eye, fov_deg=55.0, target=(0.65, 0.0, 0.0)):
    return Camera.from_fov(look_at(eye, target), *SIZE, fov_deg)


def seen(cameras, tags, noise=0.0, only=None, moved=None):
    """{photograph: {tag: pixels}} of exact cameras; moved: {tag: shift [m]} of tags that lie elsewhere."""
    rng = np.random.default_rng(0)
    corners = {n: c + (moved or {}).get(n, 0) for n, c in tags.corners().items() if only is None or n in only}
    return {f"{i}": {n: c.project(p) + noise * rng.normal(size=(4, 2)) for n, p in corners.items()} for i, c in enumerate(cameras)}


CAMERAS = [camera((0.1, -0.9, 0.8)), camera((0.2, 0.9, 0.9))]


def off(solved, cameras):
    return max(np.linalg.norm(solved.poses[f"{i}"][:3, 3] - c.centre) for i, c in enumerate(cameras))


@settings(max_examples=5, deadline=None)
@given(st.floats(-2.4, 2.4), st.floats(0.5, 1.3), st.floats(35, 80), st.booleans())
def test_exact_corners_give_cameras_and_focal_length_back(azimuth, height, fov, flat):
    eyes = [(0.65 + 0.9 * np.cos(a), 0.9 * np.sin(a), height) for a in (azimuth, azimuth + 1.2)]
    cameras, tags = [camera(eye, fov) for eye in eyes], layout() if flat else layout((0.0, 0.1, 0.2, 0.05))
    solved = solve(seen(cameras, tags), tags, SIZE)
    assert off(solved, cameras) < 1e-5 and solved.focal == pytest.approx(cameras[0].K[0, 0], rel=1e-5)
    assert solved.residual_px < 1e-4 and solved.warnings == ()


def test_errors_are_about_as_large_as_is_said():
    told, true = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        found = {k: {n: p + 0.3 * rng.normal(size=(4, 2)) for n, p in t.items()} for k, t in seen(CAMERAS, layout()).items()}
        solved = solve(found, layout(), SIZE, CAMERAS[0].K)
        told.append(list(solved.uncertainties_mm.values()))
        true.append([1000 * np.linalg.norm(solved.poses[f"{i}"][:3, 3] - c.centre) for i, c in enumerate(CAMERAS)])
    assert 0.5 < np.sqrt(np.mean(np.square(true)) / np.mean(np.square(told))) < 2


def test_a_tag_that_lies_elsewhere_is_named_and_left_out():
    solved = solve(seen(CAMERAS, layout(), moved={2: [0.03, 0.0, 0.0]}), layout(), SIZE, CAMERAS[0].K)
    assert solved.tags == (0, 1, 3) and off(solved, CAMERAS) < 1e-5
    assert "do not lie where the layout says: tag 2" in solved.warnings[0]


def test_two_tags_that_contradict_each_other_are_refused():
    with pytest.raises(ReconstructionFailed, match="do not lie as the layout says: of 2 tags"):
        solve(seen(CAMERAS, layout(), only=(0, 2), moved={2: [0.2, 0.0, 0.0]}), layout(), SIZE, CAMERAS[0].K)


def test_one_small_tag_far_away_is_refused_with_what_would_help():
    far = [camera((0.4, -4.0, 4.0), target=(0.4, -0.3, 0)), camera((1.5, 4.0, 4.0), target=(0.4, -0.3, 0))]
    with pytest.raises(ReconstructionFailed, match="photograph 0 shows tag 0, at most 1[0-9] px wide: .*go nearer"):
        solve(seen(far, layout(), noise=0.1, only=(0,)), layout(), SIZE, far[0].K)


def test_a_camera_that_shows_too_little_is_left_out_where_others_remain():
    cameras = [*CAMERAS, camera((0.4, -4.0, 4.0), target=(0.4, -0.3, 0))]
    found = seen(cameras, layout(), noise=0.05)
    found["2"] = {0: found["2"][0]}
    solved = solve(found, layout(), SIZE, CAMERAS[0].K)
    assert set(solved.poses) == {"0", "1"} and "left out: photograph 2 shows tag 0" in solved.warnings[0]


def test_a_focal_length_that_tags_leave_open_is_refused_unless_exif_tells_it():
    above = [camera((0.65, -0.02, 1.5)), camera((0.65, 0.3, 1.5), target=(0.65, 0.3, 0))]
    found = seen(above, layout(), noise=0.1)
    with pytest.raises(ReconstructionFailed, match="scene.resection.camera"):
        solve(found, layout(), SIZE)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """(folder of two photographs of the tiny world, its layout, true cameras)."""
    folder = tmp_path_factory.mktemp("photos")
    with World.load("tiny") as world:
        eyes = [(0.2, -0.75, 0.9), (0.35, 0.85, 0.9)]
        cameras = [Camera.from_fov(look_at(eye, (0.62, 0.0, 0.12)), 800, 600, 50) for eye in eyes]
        for i, camera in enumerate(cameras):
            save_image(folder / f"{i}.png", world.photograph(camera))
        return folder, TagLayout(world.tag_size, world.base_from_tag), cameras


def test_two_photographs_are_enough(photographs, tmp_path):
    folder, tags, cameras = photographs
    posed = resect(sorted(folder.glob("*.png")), tags, tmp_path)
    for pose, camera in zip(posed.poses, cameras, strict=True):
        assert np.linalg.norm(pose[:3, 3] - camera.centre) < 0.004
    assert posed.frame["name"] == "robot base" and posed.frame["residual_px"] < 0.3
    assert posed.lenses[0]["params"][0] == pytest.approx(cameras[0].K[0, 0], rel=0.01)
    assert "from the tags, known to" in posed.frame["rests_on"]


def test_photographs_turned_by_exif_and_its_focal_length_are_understood(photographs, tmp_path):
    folder, tags, cameras = photographs
    turned = tmp_path / "turned"
    turned.mkdir()
    for path in sorted(folder.glob("*.png")):
        exif = Image.Exif()
        exif[0x0112] = 6  # to be shown turned by 90 degrees clockwise
        exif.get_ifd(0x8769)[0xA405] = round(cameras[0].K[0, 0] / 1000 * 43.27)
        with Image.open(path) as image:
            image.rotate(90, expand=True).save(turned / f"{path.stem}.jpg", quality=98, subsampling=0, exif=exif)
    posed = resect(sorted(turned.glob("*.jpg")), tags, tmp_path)
    for pose, camera in zip(posed.poses, cameras, strict=True):
        assert np.linalg.norm(pose[:3, 3] - camera.centre) < 0.004
    assert "from the tags and EXIF" in posed.frame["rests_on"]


def test_a_camera_file_is_used_at_the_size_of_the_photographs(photographs, tmp_path):
    folder, tags, cameras = photographs
    f = 2 * cameras[0].K[0, 0]
    (tmp_path / "camera.json").write_text(json.dumps({"w": 1600, "h": 1200, "fl_x": f, "fl_y": f, "cx": 800, "cy": 600}))
    posed = resect(sorted(folder.glob("*.png")), tags, tmp_path, camera=tmp_path / "camera.json")
    assert posed.lenses[0]["params"] == pytest.approx([f / 2, f / 2, 400, 300])
    assert "as the camera file says" in posed.frame["rests_on"]
    (tmp_path / "camera.json").write_text(json.dumps({"w": 1200, "h": 1600, "fl_x": f}))
    with pytest.raises(ValueError, match="pictures of 1200x1600, these are 800x600"):
        resect(sorted(folder.glob("*.png")), tags, tmp_path, camera=tmp_path / "camera.json")


def test_photographs_without_tags_are_refused(photographs, tmp_path):
    folder, tags, _ = photographs
    other = TagLayout(0.12, {17: np.eye(4)})
    with pytest.raises(ReconstructionFailed, match="0 of 2 photographs show a tag of the layout"):
        resect(sorted(folder.glob("*.png")), other, tmp_path)


def test_photographs_of_two_cameras_are_refused(tmp_path):
    files = [tmp_path / "a.png", tmp_path / "b.png"]
    for file, shape in zip(files, ((24, 32, 3), (32, 24, 3)), strict=True):
        save_image(file, np.zeros(shape, np.uint8))
    with pytest.raises(ReconstructionFailed, match="one camera only; here are 2 cameras: 1 of 32x24, 1 of 24x32"):
        resect(files, layout(), tmp_path / "work")
    assert not (tmp_path / "work").exists()
