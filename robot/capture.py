"""Photograph a simulated world. One stage of the whole job, on the files of the one before.

    python -m robot.capture world=table robot.photographs.count=48
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[capture]")
