"""Sketches become a distribution of 3D trajectories. One stage of the whole job, on the files of the one before.

    python -m teach.fit teach.density.hidden=64
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[fit]")
