"""Which point of the hand touches, where a motion ends with a contact.

The tip's frame lies where a gripper grasps: between open fingers, and in from their ends. A person who draws a motion that
touches means the end of the hand. So a hand that touches has its fingers closed, and what follows the path is

    c = (nearest to the tip's z axis of the ends' box, h)     h: the largest z of the hand's shapes and of what it holds

in the tip's frame. A hand that opens or closes on the way grasps: that is done between its fingers, and nothing is changed.
The fingers close where the arm stands at the start; what they sweep there must be as clear as the rest of the motion.
"""

from dataclasses import replace

import numpy as np

from robot.attempt import RESOLUTION
from robot.collision import CollisionModel
from robot.separation import support
from robot.shapes import transform

ALONG = np.array([0.0, 0.0, 1.0])
FLAT = 1e-3  # m: what ends this near to the farthest end belongs to it
GRASPS = ("gripper_open", "gripper_close")


def touching(arm, model, events):
    """The Arm as it touches. model: CollisionModel of it, with what it holds. events: of the skill."""
    if any(event.name in GRASPS for event in events):
        return arm
    closed = arm if model.held else replace(arm, gripper=replace(arm.gripper, open=arm.gripper.closed))
    return replace(closed, contact=_end(closed, model))


def closing(arm, world, regions, start, margin, **bound) -> tuple[str, str] | None:
    """The names of what comes nearer to each other than ``margin`` [m] while the open fingers close in the posture ``start`` (J,); None
    where nothing does, to within the resolution. arm: as it is before. world, regions, bound: as CollisionModel takes them."""
    model = CollisionModel(_with_fingers(arm), world, regions, margin=margin, **bound)
    ends = np.stack([np.append(start, fingers) for fingers in (arm.gripper.open, arm.gripper.closed)])
    sweep = model.sweep(ends, required=margin, resolution=RESOLUTION)
    return None if sweep.clearance[0] >= margin - RESOLUTION else sweep.pairs[0]


def as_planned(arm, plan):
    """The Arm as a Plan has it: where its fingers are, and the point that is to touch."""
    return replace(arm, gripper=replace(arm.gripper, open=plan.fingers), contact=plan.contact) if plan.touches else arm


def hand_of(arm) -> list[str]:
    """The links that cannot move against the tip."""
    return [link for link in arm.link_names if link not in arm.beside_hand]


def _with_fingers(arm):
    """The Arm with its gripper's joints behind its own, closed at home, however fast they are."""
    fingers, steady = np.stack([arm.gripper.open, arm.gripper.closed]), np.ones(len(arm.gripper.joints))
    more = {"lower": fingers.min(axis=0), "upper": fingers.max(axis=0), "home": fingers[1], "velocity": steady, "acceleration": steady}
    joined = {name: np.append(getattr(arm, name), values) for name, values in more.items()}
    return replace(arm, joint_names=(*arm.joint_names, *arm.gripper.joints), **joined)


def _end(arm, model) -> np.ndarray:
    """(3,) [m] where the hand ends, see above."""
    links = arm.link_poses(arm.home)[0]
    tip_from_base = np.linalg.inv(links[arm.link_names.index(arm.tip_link)])
    hand = {*hand_of(arm), *model.held}
    placed = [(k, tip_from_base @ links[link] @ piece.frame_from_piece)
              for k, (link, piece) in enumerate(zip(model.links, model.pieces)) if piece.name in hand]  # fmt: skip
    if not placed:
        return np.zeros(3)
    height = max(support(*model.solids[k].arrays(pose), ALONG)[2] for k, pose in placed)
    corners = np.vstack([transform(pose, model.pieces[k].vertices) for k, pose in placed])
    ends = corners[corners[:, 2] >= height - FLAT, :2]
    return np.append(np.clip(0.0, ends.min(axis=0), ends.max(axis=0)), height)
