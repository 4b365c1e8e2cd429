"""The arm as the page's 3D view draws it: its links' shapes as triangles, and where the links are along a motion.

The shapes are those by which clearance is checked, as the URDF has them: meshes, boxes, cylinders, capsules, spheres.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

CLOSING = 0.3
"""Time [s] that the fingers are shown to take."""
ENDS = {"gripper_open": "open", "gripper_close": "closed"}


def body(arm) -> dict:
    """name; links: for each link that has a shape, its name, vertices (V, 3) [m] in its frame and faces (F, 3); home: where the
    links are when the arm is at home, as a row of ``link_rows``."""
    shaped = [(name, [_triangles(shape) for shape in arm.description.links[name]]) for name in _shaped(arm)]
    links = [{"name": name, **_together(meshes)} for name, meshes in shaped]
    return {"name": arm.name, "links": links, "home": link_rows(arm, [0.0], arm.home[None])[0]}


def link_rows(arm, times, joints, events=(), rows=slice(None)) -> list:
    """(T, L, 7) at joints (T, J) at times (T,) [s], or at those ``rows`` of them: position [m] and quat_xyzw of each link that has a shape, in the base frame.
    events: Events at times of these; the fingers follow them, and legs go where they go when the trunk does."""
    chosen = [arm.link_names.index(name) for name in _shaped(arm)]
    legs = arm.walk(times, joints).joints if arm.legs else np.zeros((len(times), 0))
    poses = _all_joints(arm).poses(np.concatenate([joints, legs, fingers(arm.gripper, times, events)], axis=1)[rows])[:, chosen]
    turned = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(*poses.shape[:2], 4)
    return np.concatenate([poses[..., :3, 3], turned], axis=-1).round(4).tolist()


def fingers(gripper, times, events) -> np.ndarray:
    """(T, G): the gripper's joints at times (T,) [s], open at first; each event takes CLOSING seconds. What lies between the fingers
    does not stop them here."""
    joints = np.repeat(gripper.open[None], len(times), axis=0)
    for event in sorted(events, key=lambda event: event.time):
        if event.name in ENDS:
            share = np.clip((np.asarray(times)[:, None] - event.time) / CLOSING, 0, 1)
            joints = joints + share * (getattr(gripper, ENDS[event.name]) - joints)
    return joints


def _all_joints(arm):
    """The arm's tree, with the legs' and the gripper's joints moving too, in this order behind its own."""
    names = (*arm.joint_names, *(arm.legs.joints if arm.legs else ()), *arm.gripper.joints)
    joints = [arm.description.joints.get(link) for link in arm.link_names]
    return replace(arm.tree, column=np.array([names.index(j.name) if j and j.name in names else -1 for j in joints]))


def _shaped(arm) -> list[str]:
    return [name for name in arm.link_names if arm.description.links[name]]


def _triangles(shape) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] in the link's frame and faces (F, 3) of a robot.urdf.Shape."""
    import trimesh

    make = {
        "box": lambda: trimesh.creation.box(shape.size),
        "cylinder": lambda: trimesh.creation.cylinder(shape.size[0], shape.size[1], sections=24),
        "capsule": lambda: trimesh.creation.capsule(shape.size[1], shape.size[0], count=[16, 16]),
        "sphere": lambda: trimesh.creation.icosphere(2, shape.size[0]),
        "mesh": lambda: trimesh.load(shape.mesh, force="mesh"),
    }
    mesh, scale = make[shape.kind](), shape.size if shape.kind == "mesh" else 1.0
    placed = mesh.vertices * scale @ shape.link_from_shape[:3, :3].T + shape.link_from_shape[:3, 3]
    return placed, np.asarray(mesh.faces)


def _together(meshes) -> dict:
    """Plain numbers of several meshes as one, each place but once: files repeat it for every picture on it."""
    begins = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = np.concatenate([faces + begin for (_, faces), begin in zip(meshes, begins)])
    places, of = np.unique(np.concatenate([vertices for vertices, _ in meshes]).round(4), axis=0, return_inverse=True)
    return {"vertices": places.tolist(), "faces": of.ravel()[faces].tolist()}
