"""The field shows the scene from new viewpoints. One stage of the whole job, on the files of the one before.

    python -m scene.render                                                       views to sketch on, an orbit -> views/
    python -m scene.render scene/paths=spiral scene.film.width=960               and a film -> renders/spiral/, .mp4
    python -m scene.render scene/paths=file scene.paths.file=camera_path.json    nerfstudio's or poses: scene/pathfile.py
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[render]")
