"""The arm as a body of the simulation: driven by motors, its gripper opened and closed, its touches told.

Every joint's motor goes where it is told and as fast as it is told (velocity feed-forward), within the effort that the
URDF allows. The gripper's joints, of any kind, go to where the arm's file has them open or closed, and press on what is
between them.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from robot.bullet import pybullet
from robot.contact import hand_of

STEP = 1 / 240  # s, PyBullet's own
TOUCHING = 1e-4  # m; contacts further apart than this are warnings of Bullet's margin, not touches
POSITION_GAIN = 0.3  # share of the position error that is corrected in a step
UNLIMITED = 1e3  # N m or N, where the URDF allows no effort at all
UPRIGHT = 0.7  # cosine: what a foot presses on from above it stands on
PRESS = 5.0  # N or N m, of a finger: more would push what it holds into the other finger
PROBE, FAR = 1e-3, 1.0  # m: the radius of a ball that distances are measured to, and the largest that is looked for
GRIP = 1.2  # friction of what holds things: rubber


class Robot:
    """Its state is read and written here only. arm: Arm. client: BulletClient. start (J,): the posture it rests in."""

    def __init__(self, arm, client, start):
        self.client, self.body = client, arm.spawn(client)
        self.joints, self.legs, self.fingers = list(arm.joint_indices), list(arm.leg_indices), list(arm.gripper_indices)
        legs = arm.walk([0.0], np.array(start)[None]).joints[0] if arm.legs else ()
        for joint, value in zip(self.joints + self.legs, (*start, *legs)):
            client.resetJointState(self.body, joint, float(value))
        info = [client.getJointInfo(self.body, index) for index in range(client.getNumJoints(self.body))]
        self.links = [entry[12].decode() for entry in info]
        self.tip, self.contact = self.links.index(arm.tip_link), arm.contact
        self.hand = [self.links.index(link) for link in hand_of(arm) if link in self.links]
        self.feet = [self.links.index(foot) for foot in arm.legs.feet] if arm.legs else []
        self.effort = {index: entry[10] or UNLIMITED for index, entry in enumerate(info)}
        self.speed = {index: entry[11] or UNLIMITED for index, entry in enumerate(info)}
        self.open, self.closed = list(arm.gripper.open), list(arm.gripper.closed)
        self.grip, self.rest = self.open, arm.gripper.rest
        for finger in self.fingers:
            client.changeDynamics(self.body, finger, lateralFriction=GRIP)
        client.setTimeStep(STEP)

    def step(self, now, then) -> None:
        """One step of the motors from where the plan is now (J,) to where it is ``then`` (J,), the legs' joints behind."""
        self._drive(self.joints + self.legs, now, (np.asarray(then) - now) / STEP)
        self._grip()
        self.client.stepSimulation()

    def happen(self, event: str, world) -> None:
        """The gripper opens or closes; what is held is let go as it opens. Other events are none of the gripper's."""
        if event == "gripper_open":
            self.grip = self.open
            world.let_go()
        elif event == "gripper_close":
            self.grip = self.closed

    def take(self, world) -> None:
        """What the world's file says is held is put between the fingers, and these close on it."""
        if world.spec.get("held"):
            world.put_in_hand(self.body, self.tip, self.rest)
            self.grip = self.closed

    def _grip(self) -> None:
        """The fingers go to where they are to be, no faster than they can and pressing no harder than PRESS."""
        for finger, position in zip(self.fingers, self.grip):
            self.client.setJointMotorControl2(
                self.body, finger, pybullet.POSITION_CONTROL, targetPosition=float(position), positionGain=POSITION_GAIN,
                force=min(self.effort[finger], PRESS), maxVelocity=self.speed[finger],
            )  # fmt: skip

    def _drive(self, joints, positions, speeds) -> None:
        for joint, position, speed in zip(joints, positions, speeds):
            self.client.setJointMotorControl2(
                self.body, joint, pybullet.POSITION_CONTROL,
                targetPosition=float(position), targetVelocity=float(speed),
                positionGain=POSITION_GAIN, velocityGain=1.0, force=self.effort[joint],
            )  # fmt: skip

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint values (J,) and the place (3,) [m] of the tip's contact point."""
        joints = [state[0] for state in self.client.getJointStates(self.body, self.joints)]
        place, quat_xyzw = self.client.getLinkState(self.body, self.tip, computeForwardKinematics=True)[4:6]
        return np.array(joints), place + Rotation.from_quat(quat_xyzw).apply(self.contact)

    def distance(self, point, held=()) -> float:
        """How far the hand, and the bodies that it holds, are from a point (3,) [m], by Bullet's own measure."""
        shape = self.client.createCollisionShape(pybullet.GEOM_SPHERE, radius=PROBE)
        probe = self.client.createMultiBody(0, shape, -1, list(map(float, point)))
        near = [self.client.getClosestPoints(self.body, probe, FAR, linkIndexA=link) for link in self.hand]
        near += [self.client.getClosestPoints(body, probe, FAR) for body in held]
        self.client.removeBody(probe)
        return min((p[8] + PROBE for points in near for p in points), default=np.inf)

    def touches(self) -> list[tuple[int, str, float, float]]:
        """(body, link, overlap [m], force [N]) of what the robot touches now; its fixed foot may stand on something."""
        self.client.performCollisionDetection()
        points = self.client.getContactPoints(bodyA=self.body)
        standing = lambda p: p[3] in self.feet and abs(p[7][2]) > UPRIGHT
        return [(p[2], self.links[p[3]], -p[8], p[9]) for p in points
                if p[2] != self.body and p[3] >= 0 and p[8] < TOUCHING and not standing(p)]  # fmt: skip

    def feet_down(self) -> np.ndarray:
        """(F, 3) [m] where the feet's centres are, nan for one that stands on nothing now."""
        points = self.client.getContactPoints(bodyA=self.body)
        down = {p[3] for p in points if p[2] != self.body and p[8] < TOUCHING}
        place = lambda foot: self.client.getLinkState(self.body, foot, computeForwardKinematics=True)[4]
        return np.array([place(foot) if foot in down else [np.nan] * 3 for foot in self.feet]).reshape(-1, 3)
