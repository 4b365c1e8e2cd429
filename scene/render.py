"""The field shows the scene from new viewpoints. One stage of the whole job, on the files of the one before.

    python -m scene.render scene.views.width=960 scene.views.height=720
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[render]")
