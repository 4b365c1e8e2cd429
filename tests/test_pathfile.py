"""Camera paths in files: nerfstudio's, and lists of poses."""

import json

import numpy as np
import pytest

from scene.camera import OPENCV_FROM_OPENGL, Camera, look_at
from scene.paths import load

LIKE = Camera.from_fov(np.eye(4), 640, 480, 55)
POSES = [look_at((1, 2, 3), (0, 0, 0)), look_at((-1, 2, 1), (0, 0.5, 0))]


def written(folder, content, name="path.json"):
    (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder / name


def nerfstudio(poses=POSES, **changes):
    frames = [{"camera_to_world": (pose @ OPENCV_FROM_OPENGL).ravel().tolist(), "fov": 50, "aspect": 1.5} for pose in poses]
    return {"camera_path": frames, "render_width": 960, "render_height": 640, "fps": 30} | changes


def read(path):
    return load([LIKE], file=str(path))


def test_a_path_of_nerfstudios_viewer_has_opengl_axes_and_a_vertical_field_of_view(tmp_path):
    path = read(written(tmp_path, nerfstudio()))
    for pose, camera in zip(POSES, path.cameras.values(), strict=True):
        assert camera.world_from_camera == pytest.approx(pose)
        assert (camera.width, camera.height) == (960, 640)
        top = camera.centre + camera.forward - np.tan(np.radians(25)) * camera.world_from_camera[:3, 1]
        assert camera.project(top) == pytest.approx([480, 0])
    assert path.fps == 30 and list(path.cameras) == ["0000", "0001"]


def test_a_camera_of_known_numbers(tmp_path):
    """OpenGL's identity looks down: along -z, with y up in the picture."""
    entry = {"camera_to_world": [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "fov": 90, "aspect": 1}
    content = nerfstudio(camera_path=[entry], render_width=200, render_height=100)
    camera = read(written(tmp_path, content)).cameras["0000"]
    assert camera.forward.tolist() == [0, 0, -1] and camera.centre.tolist() == [0.5, 0, 2]
    assert camera.project([0.5, 1, 1]) == pytest.approx([100, 50 - 50])


def test_what_nerfstudio_did_to_the_frame_before_training_is_undone(tmp_path):
    turn = look_at((0.3, 0.2, 0.9), (0, 0, 0))
    trained = [turn @ pose for pose in POSES]
    for pose in trained:
        pose[:3, 3] *= 0.25
    written(tmp_path, {"transform": turn[:3].tolist(), "scale": 0.25}, "dataparser_transforms.json")
    path = read(written(tmp_path, nerfstudio(trained)))
    assert np.stack([c.world_from_camera for c in path.cameras.values()]) == pytest.approx(np.stack(POSES))


def test_poses_in_the_robots_frame_are_taken_as_they_are(tmp_path):
    plain = [pose.tolist() for pose in POSES]
    path = read(written(tmp_path, plain))
    assert np.stack([c.world_from_camera for c in path.cameras.values()]) == pytest.approx(np.stack(POSES))
    assert all(np.array_equal(c.K, LIKE.K) and c.width == 640 for c in path.cameras.values()) and path.fps is None
    content = {"poses": plain, "names": ["left", "top view"], "width": 100, "height": 50, "fov_deg": 90, "fps": 12}
    path = read(written(tmp_path, content))
    assert list(path.cameras) == ["left", "top view"] and path.fps == 12
    assert path.cameras["left"].K.tolist() == [[pytest.approx(50), 0, 50], [0, pytest.approx(50), 25], [0, 0, 1]]


STRETCHED = np.diag([2.0, 1, 1, 1]).tolist()
PLAIN = [pose.tolist() for pose in POSES]
BAD = {
    "not JSON": "{",
    "neither": {"frames": []},
    "path.json holds no camera path": "3",
    "missing 'fov'": nerfstudio(camera_path=[{"camera_to_world": np.eye(4).ravel().tolist()}]),
    "missing 'render_width'": {"camera_path": nerfstudio()["camera_path"]},
    "no pose in it": nerfstudio(camera_path=[]),
    "a fisheye camera is not rendered": nerfstudio(camera_type="fisheye"),
    "frame 0: a pose is a 4x4 matrix": nerfstudio(camera_path=[{"camera_to_world": [1, 2], "fov": 50}]),
    "frame 0: fov must lie between": nerfstudio(camera_path=[nerfstudio()["camera_path"][0] | {"fov": 180}]),
    "frame 0: .*orthonormal": nerfstudio(camera_path=[{"camera_to_world": STRETCHED, "fov": 50}]),
    "0 x 480 pixels": nerfstudio(render_width=0, render_height=480),
    "pose 1: .*orthonormal": [PLAIN[0], STRETCHED],
    "pose 0: a pose": ["a"],
    "pose 0: .*finite": [np.full((4, 4), np.nan).tolist()[:3] + [[0, 0, 0, 1]]],
    "names must be 2": {"poses": PLAIN, "names": ["a"]},
    "names must be 2 different ones": {"poses": PLAIN, "names": ["a", "A"]},
    "names .* letters": {"poses": PLAIN, "names": ["a", "../b"]},
    "fps must be positive": {"poses": PLAIN, "fps": -1},
}


@pytest.mark.parametrize("message", BAD)
def test_a_bad_file_says_what_is_wrong_with_it(tmp_path, message):
    with pytest.raises(ValueError, match="path.json" if message == "neither" else message) as error:
        read(written(tmp_path, BAD[message]))
    assert "path.json" in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere.json"):
        read(tmp_path / "nowhere.json")
