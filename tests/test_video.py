"""Sharp and different frames of a video become photographs."""

import av
import cv2
import numpy as np
import pytest

from scene.album import load_photographs
from scene.dataset import load_image
from scene.video import flow, pick, sharpness

rng = np.random.default_rng(0)
SCENE = cv2.resize(rng.integers(0, 255, (60, 200, 3), dtype=np.uint8), (1000, 300), interpolation=cv2.INTER_CUBIC)


def pan(count=60, step=8):
    """A camera that moves along a wall."""
    return [np.ascontiguousarray(SCENE[:144, step * i : step * i + 192]) for i in range(count)]


def film(path, frames, codec="mpeg4", rate=30):
    with av.open(str(path), "w") as video:
        stream = video.add_stream(codec, rate=rate)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 192, 144, "yuv420p", 4_000_000
        for frame in frames:
            video.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        video.mux(stream.encode())
    return path


@pytest.mark.parametrize("ending", [".mp4", ".mov", ".avi"])
def test_frames_are_spread_over_the_video_and_can_be_reconstructed_from(tmp_path, ending):
    files = pick(film(tmp_path / f"walk{ending}", pan()), tmp_path / "photos", frames=12)
    numbers = np.array([int(path.stem) for path in files])
    assert len(files) == 12 and (numbers // 5 == np.arange(12)).all()
    assert load_photographs(tmp_path / "photos") == files
    assert np.abs(load_image(files[3]).astype(int) - pan()[numbers[3]]).mean() < 12


def test_blurred_frames_are_passed_over(tmp_path):
    frames = [cv2.blur(frame, (25, 1)) if i % 5 != 2 else frame for i, frame in enumerate(pan())]
    numbers = [int(path.stem) for path in pick(film(tmp_path / "a.mp4", frames), tmp_path / "photos", frames=12)]
    assert numbers == list(range(2, 60, 5))


def test_a_stretch_that_is_blurred_all_along_gives_no_photograph(tmp_path):
    frames = [cv2.blur(frame, (41, 41)) if 20 <= i < 40 else frame for i, frame in enumerate(pan())]
    numbers = [int(path.stem) for path in pick(film(tmp_path / "a.mp4", frames), tmp_path / "photos", frames=12)]
    assert len(numbers) == 8 and not [n for n in numbers if 20 <= n < 40]


def test_a_camera_that_rests_gives_one_photograph(tmp_path):
    frames = pan(30) + [pan(30)[-1]] * 60
    numbers = [int(path.stem) for path in pick(film(tmp_path / "a.mp4", frames), tmp_path / "photos", frames=18)]
    assert 6 <= len(numbers) <= 8 and sum(n >= 30 for n in numbers) <= 1


def test_photographs_of_an_earlier_video_are_replaced(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "old.jpg").write_bytes(b"x")
    pick(film(tmp_path / "a.mp4", pan()), tmp_path / "photos", frames=5)
    assert not (tmp_path / "photos" / "old.jpg").exists() and not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([cv2.blur(frame, (61, 61)) for frame in pan()], "0 of 10 stretches.*sharp"),
        ([pan()[0]] * 40, "only 1 different views"),
        (pan()[:2], "only 2 of 2 stretches"),
    ],
)
def test_a_video_that_shows_too_little_says_so(tmp_path, frames, message):
    with pytest.raises(ValueError, match=message):
        pick(film(tmp_path / "a.mp4", frames), tmp_path / "photos", frames=10)
    assert not (tmp_path / "photos").exists()


def test_what_is_no_video_or_cut_off_is_refused(tmp_path):
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(ValueError, match="text.mp4 is not a readable video"):
        pick(tmp_path / "text.mp4", tmp_path / "photos")
    whole = film(tmp_path / "whole.mp4", pan()).read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="cut.mp4 is not a readable video"):
        pick(tmp_path / "cut.mp4", tmp_path / "photos")
    with pytest.raises(ValueError, match="at least 3"):
        pick(tmp_path / "whole.mp4", tmp_path / "photos", frames=2)


def test_sharpness_falls_with_blur_and_flow_measures_motion():
    grey = cv2.cvtColor(SCENE, cv2.COLOR_RGB2GRAY)
    assert sharpness(grey) > 4 * sharpness(cv2.blur(grey, (9, 9))) and sharpness(np.full((50, 50), 90, np.uint8)) == 0
    assert flow(grey[:96, :128], grey[:96, 4:132]) == pytest.approx(4 / 128, rel=0.2)
