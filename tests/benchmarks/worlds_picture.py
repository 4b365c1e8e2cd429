"""The README's picture of the worlds, each with its robot before it moves.

    python tests/benchmarks/worlds_picture.py docs/worlds.jpg
"""

import sys

import cv2
import numpy as np

from robot import worldfile
from robot.arm import Arm
from robot.execution import film_camera
from robot.mounting import mounted
from robot.world import World

SHOWN = {"box": "panda", "shelf": "panda", "shelf_small": "panda", "board": "panda", "push_box": "z1", "drop_into_cup": "z1", "tip_box": "z1",
         "drop_into_box": "aliengo_z1", "close_drawer": "aliengo_z1"}  # fmt: skip
WIDTH, HEIGHT, COLUMNS = 426, 320, 3


def photograph(name: str, robot: str) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) of the world where its performance is filmed from."""
    spec, arm = mounted(worldfile.read(name), Arm.load(robot))
    with World.from_spec(spec) as world:
        arm.spawn(world.client)
        world.bring_held(arm, arm.home)
        return world.photograph(film_camera(world.spec, WIDTH, HEIGHT))


def main(path: str) -> None:
    pictures = [photograph(*shown) for shown in SHOWN.items()]
    rows = [np.concatenate(pictures[k : k + COLUMNS], axis=1) for k in range(0, len(pictures), COLUMNS)]
    cv2.imwrite(path, np.concatenate(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main(*sys.argv[1:])
