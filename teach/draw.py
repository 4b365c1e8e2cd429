"""The motion is drawn on views of the scene. One stage of the whole job, on the files of the one before.

    python -m teach.draw user=scripted seed=1
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[sketch]")
