"""The simulated robot performs the plan. One stage of the whole job, on the files of the one before.

    python -m robot.execute robot.execution.fps=25
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[execute]")
