"""A path becomes files, and a killed job goes on where it stopped."""

import cv2
import numpy as np
import pytest
from fields import Painter

from robot.execution import save_video
from scene.camera import Camera, orbit
from scene.dataset import load_frame, load_views
from scene.film import Pictures, film, save_depth_png, shaped
from scene.paths import CameraPath
from scene.views import load_confidences, load_depths

CAMERAS = [Camera.from_fov(pose, 32, 24, 55) for pose in orbit((0, 0, 0), 1, 20, 4)]
PATH = CameraPath({f"{i:04d}": camera for i, camera in enumerate(CAMERAS)})


COLOURS = (40, 80, 120, 160)


def test_a_film_is_pictures_depth_cameras_and_a_video(tmp_path):
    frame = {"name": "robot base", "unit": "m"}
    counted = film(Painter(), PATH, tmp_path / "orbit", identity="a", save_video=save_video, depth_png=True, frame=frame)
    assert counted == {"frames": 4, "rendered": 4}
    views = load_views(tmp_path / "orbit")
    assert [np.array_equal(v.camera.world_from_camera, c.world_from_camera) for v, c in zip(views, CAMERAS)] == [True] * 4
    assert load_frame(tmp_path / "orbit")["name"] == "robot base"
    depths = load_depths(tmp_path / "orbit", PATH.cameras)
    assert len(depths) == 4 and all(d.dtype == np.float32 and (d == 2.5).all() for d in depths.values())
    assert all((sure == 1).all() for sure in load_confidences(tmp_path / "orbit", PATH.cameras).values())
    assert (cv2.imread(str(tmp_path / "orbit" / "0002_depth.png"), cv2.IMREAD_UNCHANGED) == 2500).all()
    video = cv2.VideoCapture(str(tmp_path / "orbit.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 4 and video.get(cv2.CAP_PROP_FPS) == 24


def test_a_killed_film_goes_on_with_what_is_missing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        film(Painter(lives=2), PATH, tmp_path, identity="a")
    assert not (tmp_path / "transforms.json").exists() and len(list(tmp_path.glob("*_depth.npy"))) == 2
    again = Painter()
    assert film(again, PATH, tmp_path, identity="a") == {"frames": 4, "rendered": 2}
    assert [c is d for c, d in zip(again.painted, CAMERAS[2:], strict=True)] == [True, True]
    (tmp_path / "0001_depth.npy").unlink()
    assert film(again, PATH, tmp_path, identity="a")["rendered"] == 1


OTHER = [{"identity": "b"}, {"near": 0.5}, {"far": 3.0}, {"width": 16}, {"fov_deg": 40}, {"only_missing": False}]
IMPOSSIBLE = [{"near": -1}, {"near": 2, "far": 1}, {"fps": -3}, {"width": 0}, {"height": -2}, {"fov_deg": 180}, {"width": "abc"}, {"near": "1 m"}]


@pytest.mark.parametrize("change", OTHER)
def test_pictures_of_another_field_or_camera_are_not_kept(tmp_path, change):
    film(Painter(), PATH, tmp_path, identity="a")
    assert film(Painter(), PATH, tmp_path, **{"identity": "a"} | change)["rendered"] == 4


def test_of_a_path_that_changed_only_what_differs_is_rendered_and_what_is_left_over_goes(tmp_path):
    film(Painter(), PATH, tmp_path, identity="a", depth_png=True)
    changed = CameraPath({"0000": CAMERAS[0], "0001": CAMERAS[3]})
    assert film(Painter(), changed, tmp_path, identity="a") == {"frames": 2, "rendered": 1}
    names = {path.name for path in tmp_path.iterdir()}
    kept = {"0000.png", "0000_depth.npy", "0000_confidence.png", "0000_depth.png", "0001.png", "0001_depth.npy", "0001_confidence.png"}
    assert names == kept | {"planned.json", "transforms.json"}


def test_near_and_far_reach_the_field_and_a_file_gives_the_rate(tmp_path):
    path, painter, rates = CameraPath(PATH.cameras, 12), Painter(), []
    keep = lambda file, pictures, fps: rates.append(fps)
    film(painter, path, tmp_path, identity="a", save_video=keep)
    assert painter.limits == {"near": 0.0, "far": float("inf")}
    film(painter, path, tmp_path, identity="a", near=0.2, far=4, fps=7, save_video=keep)
    assert painter.limits == {"near": 0.2, "far": 4} and rates == [12, 7]


def test_a_size_crops_and_a_field_of_view_zooms():
    camera = CAMERAS[0]
    assert shaped(camera) is camera
    assert (shaped(camera, width=64).height, shaped(camera, height=48).width) == (48, 64)
    wide = shaped(camera, 64, 24)
    assert wide.K[0, 0] == wide.K[1, 1] == pytest.approx(2 * camera.K[0, 0])
    assert shaped(camera, fov_deg=90).K[0, 0] == pytest.approx(16)


@pytest.mark.parametrize("bad", IMPOSSIBLE)
def test_impossible_settings_are_refused_before_anything_is_written(tmp_path, bad):
    with pytest.raises(ValueError):
        film(Painter(), PATH, tmp_path / "film", identity="a", **bad)
    assert not (tmp_path / "film").exists()


def test_depth_in_millimetres_has_nothing_where_nothing_is_hit(tmp_path):
    save_depth_png(tmp_path / "d.png", np.array([[0.0014, np.nan], [65.535, 70.0]], np.float32))
    assert cv2.imread(str(tmp_path / "d.png"), cv2.IMREAD_UNCHANGED).tolist() == [[1, 0], [65535, 0]]


def test_pictures_are_read_one_at_a_time(tmp_path):
    film(Painter(colours=COLOURS), PATH, tmp_path, identity="a")
    pictures = Pictures([tmp_path / f"{i:04d}.png" for i in range(4)])
    assert len(pictures) == 4 and [p[0, 0, 0] for p in pictures] == list(COLOURS) and pictures[1].shape == (24, 32, 3)
