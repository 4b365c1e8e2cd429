"""What things of a world are in PyBullet: their collision shapes, and the rail that a thing on a joint runs on.

A thing's middle lies at ``at`` (3,) [m] in the frame that moves: 0, but for what turns about a hinge beside it.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from robot import thing as things
from robot.bullet import pybullet

KINDS = {"prismatic": pybullet.JOINT_PRISMATIC, "revolute": pybullet.JOINT_REVOLUTE}


def collision_shape(client, thing: dict, at) -> int:
    """The thing's primitives as one shape, or its mesh (as PyBullet's convex hull of it)."""
    if thing["shape"] == "mesh":
        return client.createCollisionShape(pybullet.GEOM_MESH, fileName=str(thing["file"]), collisionFramePosition=list(at))
    shapes = things.primitives(thing)
    boxes = [kind == "box" for kind, _, _ in shapes]
    return client.createCollisionShapeArray(
        shapeTypes=[pybullet.GEOM_BOX if is_box else pybullet.GEOM_CYLINDER for is_box in boxes],
        halfExtents=[(np.array(size) / 2).tolist() if is_box else [0, 0, 0] for is_box, (_, size, _) in zip(boxes, shapes)],
        radii=[0 if is_box else size[0] for is_box, (_, size, _) in zip(boxes, shapes)],
        lengths=[0 if is_box else size[1] for is_box, (_, size, _) in zip(boxes, shapes)],
        collisionFramePositions=[(at + pose[:3, 3]).tolist() for _, _, pose in shapes],
        collisionFrameOrientations=[Rotation.from_matrix(pose[:3, :3]).as_quat().tolist() for _, _, pose in shapes],
    )


def on_rail(client, joint: dict, mass, shapes, position, quat_xyzw, at) -> int:
    """A body whose only link, of (collision, visual) shape, is moved by the joint; its base is not seen and stays.

    position, quat_xyzw: of the link's frame. The joint's axis is in the world's frame; its motor is its friction.
    """
    axis = np.array(joint["axis"], dtype=float) / np.linalg.norm(joint["axis"])
    collision, visual = shapes
    body = client.createMultiBody(
        0, -1, -1, position, quat_xyzw, linkMasses=[mass], linkCollisionShapeIndices=[collision],
        linkVisualShapeIndices=[visual], linkPositions=[[0, 0, 0]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[at.tolist()], linkInertialFrameOrientations=[[0, 0, 0, 1]], linkParentIndices=[0],
        linkJointTypes=[KINDS[joint["type"]]], linkJointAxis=[Rotation.from_quat(quat_xyzw).inv().apply(axis).tolist()],
    )  # fmt: skip
    client.changeDynamics(body, 0, jointLowerLimit=joint["lower"], jointUpperLimit=joint["upper"])
    client.setJointMotorControl2(body, 0, pybullet.VELOCITY_CONTROL, force=joint.get("friction", 0))
    return body
