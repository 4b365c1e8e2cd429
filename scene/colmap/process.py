"""What runs in a process of its own, the only one that loads pycolmap: its tasks read JSON and answer with JSON."""

import ctypes
import json
import os
import signal
import sys
import threading

import numpy as np

from scene.album import flat
from scene.colmap import adoption, mapping
from scene.model import ReconstructionFailed


def answer_rays():
    """Read photographs' pixels, answer with x / z, y / z of the rays that the estimated lens sends through them."""
    settings = json.loads(sys.stdin.readline())
    model = load_pycolmap().Reconstruction(settings["sparse"])
    lenses = {flat(image.name): model.cameras[image.camera_id] for image in model.images.values()}
    rays, outside = {}, {}
    for name, pixels in settings["pixels"].items():
        pixels, size = np.array(pixels), (lenses[name].width, lenses[name].height)
        rays[name] = np.asarray(lenses[name].cam_from_img(pixels)).tolist()
        outside[name] = f"it is {size[0]}x{size[1]}" if (pixels < 0).any() or (pixels > size).any() else ""
    print(json.dumps({"rays": rays, "outside": outside}))


def work():
    """Read the settings, answer with lines of JSON; end at once when whoever asked is gone."""
    settings = json.loads(sys.stdin.readline())
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which ends this process
    die_with_parent()
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints goes to the log

    def say(**message):
        answers.write(json.dumps(message) + "\n")

    try:
        task = {"solve": mapping.solve, "adopt": adoption.adopt}[settings.pop("task")]
        task(load_pycolmap(), say=say, **settings)
        say(done=True)
    except ReconstructionFailed as failure:
        say(failure=str(failure))


def load_pycolmap():
    """pycolmap, after those whose zlib it would otherwise take the place of."""
    import zlib  # noqa: F401

    import cv2  # noqa: F401
    import pycolmap

    return pycolmap


def die_with_parent():
    """End when the other end of stdin is gone; on Linux by the kernel, as pycolmap holds the interpreter for long."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
