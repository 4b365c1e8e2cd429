"""A plan as other programs read it: ROS 2's trajectory_msgs/JointTrajectory in an MCAP file.

Joints go by their names; the first point is the present state. ``ros2 bag play plan.mcap`` publishes it, Foxglove and
PlotJuggler show it.
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np

from scene.files import replacing

TOPIC = "/joint_trajectory"


def save_mcap(plan, path) -> None:
    """Write a Plan's joint trajectory as the one message of an MCAP file; whole or not at all."""
    from rosbags.rosbag2 import StoragePlugin, Writer  # here, since reading all message definitions takes half a second
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    message = _message(plan.joint_trajectory(), store.types)
    with replacing(path) as temporary, tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "plan"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(TOPIC, message.__msgtype__, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(message, message.__msgtype__))
        (file,) = bag.glob("*.mcap")
        shutil.copyfile(file, temporary)


def _message(trajectory: dict, types):
    """The dictionary of Plan.joint_trajectory as a message."""
    time, span = types["builtin_interfaces/msg/Time"], types["builtin_interfaces/msg/Duration"]
    header, point = types["std_msgs/msg/Header"], types["trajectory_msgs/msg/JointTrajectoryPoint"]
    given = trajectory["header"]
    points = [
        point(
            **{key: np.array(p[key], dtype=float) for key in ("positions", "velocities", "accelerations", "effort")},
            time_from_start=span(**p["time_from_start"]),
        )
        for p in trajectory["points"]
    ]
    whole = header(stamp=time(**given["stamp"]), frame_id=given["frame_id"])
    return types["trajectory_msgs/msg/JointTrajectory"](header=whole, joint_names=trajectory["joint_names"], points=points)
