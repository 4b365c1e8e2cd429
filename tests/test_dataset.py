import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from scene import dataset
from scene.camera import Camera, View, look_at

rng = np.random.default_rng(0)


def picture(width=32, height=24, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def view(name="a", eye=(1.0, 2.0, 3.0), size=(32, 24), seed=0):
    return View(name, Camera.from_fov(look_at(eye, (0.1, 0.2, 0.0)), *size, 51.3), picture(*size, seed=seed))


def edited(folder, edit):
    """A saved capture whose transforms.json is changed by ``edit``."""
    dataset.save_views(folder, [view("a"), view("b", (2, 1, 1), seed=1)])
    meta = json.loads((folder / "transforms.json").read_text())
    edit(meta)
    (folder / "transforms.json").write_text(json.dumps(meta))
    return folder


def test_views_return_exactly_as_saved(tmp_path):
    views = [view("b"), view("a", (0.3, -1.7, 0.9), seed=1)]
    points, colours = rng.normal(size=(50, 3)), rng.integers(0, 256, (50, 3), dtype=np.uint8)
    frame = {"name": "robot base", "unit": "m", "residual_mm": 0.8}
    original = np.diag([2.0, 2.0, 2.0, 1.0])
    dataset.save_views(tmp_path, views, points=points, colours=colours, frame=frame, original=original)
    for saved, loaded in zip(views, dataset.load_views(tmp_path), strict=True):
        assert saved.name == loaded.name
        assert np.array_equal(saved.image, loaded.image)
        assert np.array_equal(saved.camera.K, loaded.camera.K)
        assert np.array_equal(saved.camera.world_from_camera, loaded.camera.world_from_camera)
    assert all(np.array_equal(a, b) for a, b in zip((points, colours), dataset.load_points(tmp_path)))
    assert dataset.load_frame(tmp_path) == frame | {"world_from_original": original.tolist()}
    assert not list(tmp_path.rglob("*.part"))


@settings(max_examples=25, deadline=None)
@given(
    eye=st.tuples(*[st.floats(-1e3, 1e3).filter(lambda v: abs(v) > 0.01)] * 3),
    lens=st.tuples(st.floats(1, 1e5), st.floats(1, 1e5), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
)
def test_every_camera_survives_the_file_to_the_last_bit(tmp_path_factory, eye, lens):
    folder = tmp_path_factory.mktemp("capture")
    fx, fy, cx, cy = lens
    camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), look_at(eye, (0, 0, 0)), 4, 3)
    dataset.save_views(folder, [View("v", camera, picture(4, 3)), view("w")])
    loaded = dataset.load_views(folder)[0].camera
    assert np.array_equal(loaded.K, camera.K) and np.array_equal(loaded.world_from_camera, camera.world_from_camera)


def test_the_rays_nerfstudio_makes_of_the_file_are_ours(tmp_path):
    """nerfstudio: direction ((i + 0.5 - cx) / fl_x, -(j + 0.5 - cy) / fl_y, -1) in axes of transform_matrix."""
    dataset.save_views(tmp_path, [view()])
    meta = json.loads((tmp_path / "transforms.json").read_text())
    matrix = np.array(meta["frames"][0]["transform_matrix"])
    i, j = 5, 17
    theirs = matrix[:3, :3] @ [(i + 0.5 - meta["cx"]) / meta["fl_x"], -(j + 0.5 - meta["cy"]) / meta["fl_y"], -1]
    camera = dataset.load_views(tmp_path)[0].camera
    origin, ours = camera.rays(camera.pixel_centres()[j, i])
    assert np.allclose(theirs / np.linalg.norm(theirs), ours) and np.allclose(matrix[:3, 3], origin)


def test_nerfstudio_is_told_that_no_axes_were_exchanged(tmp_path):
    """Without the key it takes any folder with colmap/sparse/0 for one made by itself."""
    dataset.save_views(tmp_path, [view()])
    assert json.loads((tmp_path / "transforms.json").read_text())["applied_transform"] == np.eye(4)[:3].tolist()


def test_a_scene_without_points_has_none(tmp_path):
    dataset.save_views(tmp_path, [view()], points=np.empty((0, 3)))
    points, colours = dataset.load_points(tmp_path)
    assert points.shape == colours.shape == (0, 3)


def test_a_picture_that_is_there_already_is_kept(tmp_path):
    Image.fromarray(picture(seed=3)).save(tmp_path / "a.jpg")
    image = dataset.load_image(tmp_path / "a.jpg")
    before = os.stat(tmp_path / "a.jpg").st_mtime_ns
    dataset.save_views(tmp_path, [View("a", view().camera, image)], images=".")
    assert os.stat(tmp_path / "a.jpg").st_mtime_ns == before and not (tmp_path / "a.png").exists()
    dataset.save_views(tmp_path, [view("a")], images=".")
    assert np.array_equal(dataset.load_views(tmp_path)[0].image, view().image)


def test_a_save_that_fails_leaves_what_was_there(tmp_path):
    dataset.save_views(tmp_path, [view("a")])
    before = (tmp_path / "transforms.json").read_bytes()
    with pytest.raises(ValueError):
        dataset.save_views(tmp_path, [view("a")], frame={"residual_mm": float("nan")})
    assert (tmp_path / "transforms.json").read_bytes() == before and not list(tmp_path.rglob("*.part"))


BROKEN = {
    "missing.*fl_x, cy": lambda m: [m.pop("fl_x"), m.pop("cy")],
    "frame 1.*missing transform_matrix": lambda m: m["frames"][1].pop("transform_matrix"),
    "frame 0.*a.png.*orthonormal": lambda m: m["frames"][0]["transform_matrix"][0].__setitem__(0, 3.0),
    "last row": lambda m: m["frames"][0]["transform_matrix"][3].__setitem__(0, 1.0),
    "no such file": lambda m: m["frames"][0].update(file_path="images/other.png"),
    "outside the capture folder": lambda m: m["frames"][0].update(file_path="/etc/passwd"),
    "outside": lambda m: m["frames"][0].update(file_path="../x.png"),
    "lens distortion.*k1 0.1": lambda m: m.update(k1=0.1),
    "w, h say 99x24": lambda m: m.update(w=99),
    "must be positive": lambda m: m.update(fl_x=-4),
    "list of at least one frame": lambda m: m.update(frames=[]),
    "more than one frame is called a": lambda m: m["frames"][1].update(file_path="images/a.png"),
    "transforms.json, frame 0": lambda m: m["frames"][0].update(transform_matrix="abc"),
}


@pytest.mark.parametrize("message", BROKEN)
def test_a_broken_transforms_file_says_what_is_wrong(tmp_path, message):
    folder = edited(tmp_path, BROKEN[message])
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        dataset.load_views(folder)


def test_a_folder_without_transforms_says_what_to_do(tmp_path):
    with pytest.raises(FileNotFoundError, match="reconstruct"):
        dataset.load_views(tmp_path)
    (tmp_path / "transforms.json").write_text("{")
    with pytest.raises(ValueError, match="not JSON"):
        dataset.load_views(tmp_path)


def test_a_broken_point_cloud_is_refused(tmp_path):
    dataset.save_views(tmp_path, [view()], points=np.zeros((5, 3)))
    assert dataset.load_points(tmp_path)[1].tolist() == [[128] * 3] * 5
    (tmp_path / "sparse.ply").write_bytes(b"ply\nnonsense")
    with pytest.raises(ValueError, match="not a readable ply"):
        dataset.load_points(tmp_path)


def test_opencv_reads_what_is_written(tmp_path):
    dataset.save_image(tmp_path / "a.png", picture())
    assert np.array_equal(cv2.imread(str(tmp_path / "a.png"))[..., ::-1], picture())
    assert Path(tmp_path / "a.png").stat().st_size > 0
