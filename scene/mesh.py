"""The field becomes a mesh, convex pieces of it and a map of free space. One stage of the whole job, on the files of the one before.

    python -m scene.mesh                      mesh.ply, mesh.png, collision/*.obj, space.npz in the capture folder
"""

from conf.pipeline import main

if __name__ == "__main__":
    main("stages=[surface]")
