"""Posed views become a radiance field. One stage of the whole job, on the files of the one before.

    python -m scene.train scene.fit.seconds=60
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[train]")
