"""Where the arm begins."""

import numpy as np
import pytest

from robot.arm import Arm
from robot.start import home, scattered


@pytest.fixture(scope="module")
def panda():
    return Arm.load("panda")


def test_starts_are_seeded_lie_in_the_ball_and_turn_the_hand_as_at_home(panda):
    base_from_tip = panda.fk(home(panda, seed=3))
    starts = [scattered(panda, seed=seed, radius=0.08) for seed in (0, 1, 2, 1)]
    np.testing.assert_array_equal(starts[1], starts[3])
    for q in starts:
        moved = panda.fk(q)
        assert panda.within_limits(q)[0] and np.linalg.norm(moved[:3, 3] - base_from_tip[:3, 3]) < 0.081
        np.testing.assert_allclose(moved[:3, :3], base_from_tip[:3, :3], atol=0.02)
    assert np.linalg.norm(panda.fk(starts[0])[:3, 3] - panda.fk(starts[1])[:3, 3]) > 0.005
