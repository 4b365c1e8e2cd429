"""A video becomes photographs: sharp frames, well spread over it, none of them twice.

The sharpness of a frame is the variance of its Laplacian (Pech-Pacheco et al. 2000), which motion blur takes away; what
has moved since the last frame that was kept is the dense optical flow between the two.
"""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scene.dataset import FEWEST_PHOTOGRAPHS, save_image

WIDTH = 320  # px at which sharpness is measured: finer detail is a matter of the sensor's noise
THUMB = 128  # px at which frames are compared
LEAST_SHARPNESS = 6.0  # grey levels^2; a frame without any focus has less, a wall with some texture more
SHARE = 0.2  # of the sharpness usual in the video, that a frame must have
LEAST_FLOW = 0.008  # of the picture's width, that nine tenths of a frame's pixels may fall short of
CANDIDATES = 8  # frames looked at for one that is kept


@dataclass(frozen=True, eq=False)
class _Seen:
    """A frame: its number, sharpness, and a small grey picture."""

    number: int
    sharpness: float
    thumb: np.ndarray


def pick(file: str | Path, folder: str | Path, *, frames: int = 60) -> list[Path]:
    """Write about ``frames`` pictures of a video into ``folder`` (which is replaced whole); returns their files, sorted.

    Raises ValueError when the file is no video, or too few of its frames are sharp or differ.
    """
    if frames < FEWEST_PHOTOGRAPHS:
        raise ValueError(f"a scene needs at least {FEWEST_PHOTOGRAPHS} frames of a video, not {frames}")
    file, folder = Path(file), Path(folder)
    chosen = {seen.number for seen in _distinct(_sharpest(_look(file, frames), frames, file), file)}
    unfinished = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        for number, image in _decoded(file):
            if number in chosen:
                save_image(unfinished / f"{number:06d}.jpg", image())
        shutil.rmtree(folder, ignore_errors=True)
        unfinished.replace(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return sorted(folder.iterdir())


def sharpness(grey: np.ndarray) -> float:
    """The variance of the Laplacian of a picture (h, w) uint8 [grey levels^2]."""
    import cv2

    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def flow(a: np.ndarray, b: np.ndarray) -> float:
    """How far most of what is seen moves from one small picture (h, w) uint8 to another [fraction of the width]."""
    import cv2

    moved = cv2.calcOpticalFlowFarneback(a, b, None, 0.5, 3, 15, 3, 5, 1.2, 0)
    return float(np.percentile(np.linalg.norm(moved, axis=-1), 90)) / a.shape[1]


def _look(file: Path, frames: int) -> list[_Seen]:
    import cv2

    count = sum(1 for _ in _decoded(file))
    step = max(1, count // (CANDIDATES * frames))
    seen = []
    for number, image in _decoded(file):
        if number % step == 0:
            grey = cv2.cvtColor(image(), cv2.COLOR_RGB2GRAY)
            measured = _narrowed(grey, min(WIDTH, grey.shape[1]))
            seen.append(_Seen(number, sharpness(measured), _narrowed(grey, THUMB)))
    return seen


def _narrowed(grey: np.ndarray, width: int) -> np.ndarray:
    import cv2

    height = max(8, grey.shape[0] * width // grey.shape[1])
    return cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)


def _sharpest(seen: list[_Seen], frames: int, file: Path) -> list[_Seen]:
    """The sharpest frame of each of ``frames`` equal windows, without those that are blurred all the same."""
    windows = np.array_split(np.arange(len(seen)), min(frames, len(seen)))
    best = [max((seen[i] for i in window), key=lambda s: s.sharpness) for window in windows]
    needed = max(LEAST_SHARPNESS, SHARE * float(np.median([s.sharpness for s in best])) if best else 0.0)
    sharp = [s for s in best if s.sharpness >= needed]
    if len(sharp) < FEWEST_PHOTOGRAPHS:
        raise ValueError(
            f"only {len(sharp)} of {len(best)} stretches of {file} have a sharp frame; film slowly, in good light, "
            "and things with texture"
        )
    return sharp


def _distinct(sharp: list[_Seen], file: Path) -> list[_Seen]:
    """Those that show the scene from elsewhere than the one kept before."""
    kept = sharp[:1]
    for seen in sharp[1:]:
        if flow(kept[-1].thumb, seen.thumb) >= LEAST_FLOW:
            kept.append(seen)
    if len(kept) < FEWEST_PHOTOGRAPHS:
        raise ValueError(f"{file} shows only {len(kept)} different views: walk around the scene with the camera")
    return kept


def _decoded(file: Path) -> Iterator[tuple[int, Callable[[], np.ndarray]]]:
    """Number and picture of each frame; the picture (H, W, 3) uint8 is made, upright, when it is called."""
    import av

    number = -1
    try:
        with av.open(str(file)) as video:
            if not video.streams.video:
                raise ValueError(f"{file} has sound, but no pictures")
            stream = video.streams.video[0]
            stream.thread_type = "AUTO"
            for number, frame in enumerate(video.decode(stream)):
                yield number, lambda frame=frame: _upright(frame)
    except av.FFmpegError as error:
        raise ValueError(f"{file} is not a readable video, or was cut off after {number + 1} frames: {error}") from error
    if number < 0:
        raise ValueError(f"{file} is a video without frames")


def _upright(frame) -> np.ndarray:
    """A telephone held upright stores its pictures lying, and how they are to be turned."""
    return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90)))
