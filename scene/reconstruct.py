"""Photographs become posed views in the robot's frame. One stage of the whole job, on the files of the one before.

    python -m scene.reconstruct photos=DIR
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[reconstruct]")
