"""The distribution becomes a checked, timed motion. One stage of the whole job, on the files of the one before.

    python -m robot.plan robot.planner.samples=50
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[plan]")
