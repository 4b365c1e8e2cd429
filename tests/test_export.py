"""What is exported is what was planned, read back by the format's own reader."""

import numpy as np
import pytest

from robot.export import TOPIC, save_mcap
from robot.planner import Plan


@pytest.fixture
def plan():
    times, zeros = np.linspace(0, 2, 101), np.zeros(101)
    joints = np.column_stack([np.sin(times), 1 - np.cos(times)]) * times[:, None] * (2 - times)[:, None]
    return Plan(times, joints, ("shoulder", "elbow"), zeros, zeros, zeros, np.zeros((101, 3)), (), 1, 0, True)


def read(path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        ((connection, time, raw),) = reader.messages()
        return connection.topic, time, reader.deserialize(raw, connection.msgtype)


def test_an_mcap_file_holds_the_joint_trajectory(plan, tmp_path):
    save_mcap(plan, tmp_path / "plan.mcap")
    topic, time, message = read(tmp_path / "plan.mcap")
    assert (topic, time, message.joint_names) == (TOPIC, 0, ["shoulder", "elbow"])
    wanted = plan.joint_trajectory()["points"]
    assert len(message.points) == len(wanted) == 101
    for point, want in zip(message.points, wanted):
        np.testing.assert_array_equal(point.positions, want["positions"])
        np.testing.assert_array_equal(point.velocities, want["velocities"])
        np.testing.assert_array_equal(point.accelerations, want["accelerations"])
        assert (point.time_from_start.sec, point.time_from_start.nanosec) == tuple(want["time_from_start"].values())
    assert [f.name for f in tmp_path.iterdir()] == ["plan.mcap"]


def test_the_same_plan_gives_the_same_file(plan, tmp_path):
    for name in ("a.mcap", "b.mcap"):
        save_mcap(plan, tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
