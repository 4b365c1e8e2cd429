"""Where the arm is when a motion is asked for: the posture (J,) [rad] that planning begins at."""

import numpy as np

from robot.arm import Arm, NoSolution

TRIES = 50


def home(arm: Arm, *, seed: int = 0) -> np.ndarray:
    """The arm's home posture, whatever the seed."""
    return arm.home


def scattered(arm: Arm, *, seed: int = 0, radius: float = 0.08) -> np.ndarray:
    """A posture near home whose tip is drawn evenly from the ball of ``radius`` [m] around home's, turned as there.

    Raises NoSolution where the arm reaches none of TRIES draws.
    """
    rng, base_from_tip = np.random.default_rng([seed, 2]), arm.fk(arm.home)
    for _ in range(TRIES):
        direction = rng.normal(size=3)
        moved = base_from_tip.copy()
        moved[:3, 3] += radius * rng.uniform() ** (1 / 3) * direction / np.linalg.norm(direction)
        try:
            return arm.ik(moved, start=arm.home)
        except NoSolution:
            continue
    raise NoSolution(f"the arm reaches none of {TRIES} places within {radius} m of its home")
