"""Steps under a trunk that travels: the feet stay planted while the legs can follow, and step in pairs where they cannot.

The trunk's motion is given (planned together with the arm's). Time is cut into half cycles of SWING seconds. In each, the
diagonal pair of feet that is farther from where it should stand swings there if it is more than NEAR off; the other feet
stay where they are. A foot should stand below its hip in the middle of the time that it will stand: SWING / 2 after it has
landed. With u in [0, 1] the share of the swing, a swinging foot goes

    along     u - sin(2 pi u) / (2 pi)             up     LIFT (1 - cos(2 pi u)) / 2

so that it leaves and meets the ground upright and at rest. A trunk that only sinks, pitches or leans makes no step: knees
bend.
"""

from dataclasses import dataclass

import numpy as np

from robot.legs import Legs

SWING, LIFT, NEAR = 0.25, 0.05, 0.04  # s, m, m
PAIRS = ((0, 3), (1, 2))  # of feet: front left and rear right, front right and rear left


@dataclass(frozen=True, eq=False)
class Walk:
    """times (T,) [s]. joints (T, 3F) [rad] of the legs. feet (T, F, 3) [m] centres. stands (T, F) bool: is planted."""

    times: np.ndarray
    joints: np.ndarray
    feet: np.ndarray
    stands: np.ndarray

    @property
    def steps(self) -> int:
        """How often a foot was lifted."""
        return int((self.stands[:-1] & ~self.stands[1:]).sum())


def walk(legs: Legs, times, world_from_trunk) -> Walk:
    """times (T,) [s], the trunk's poses (T, 4, 4) then -> Walk. Raises NoSolution where a leg does not reach."""
    times, wanted = np.asarray(times, dtype=float), legs.stance(world_from_trunk)
    at = lambda time: min(int(np.searchsorted(times, time)), len(times) - 1)
    feet, stands = np.repeat(wanted[:1], len(times), axis=0), np.ones((len(times), len(legs.feet)), bool)
    begin = float(times[0])
    while begin + SWING <= times[-1] + 1e-9:
        here, there = feet[at(begin)], wanted[at(begin + 1.5 * SWING)]
        off = np.linalg.norm(there - here, axis=1)
        pair = max(PAIRS, key=lambda pair: off[list(pair)].max())
        if off[list(pair)].max() > NEAR:
            for foot in pair:
                _swing(feet, stands, times, foot, begin, there[foot])
        begin += SWING
    return Walk(times, legs.angles(world_from_trunk, feet), feet, stands)


def slipped(feet) -> float:
    """The farthest [m] that a foot moves while it stands: feet (N, F, 3) [m], nan where one does not."""
    farthest = 0.0
    for foot in np.moveaxis(feet, 1, 0):
        down = ~np.isnan(foot[:, 0])
        for k in np.split(np.arange(len(foot)), np.flatnonzero(down[1:] != down[:-1]) + 1):
            if down[k[0]]:
                farthest = max(farthest, float(np.linalg.norm(foot[k] - foot[k[0]], axis=1).max()))
    return farthest


def _swing(feet, stands, times, foot, begin, there) -> None:
    """One foot's swing, from where it is to ``there`` (3,) [m]; it stays there."""
    u = np.clip((times - begin) / SWING, 0, 1)
    here = feet[np.searchsorted(times, begin), foot].copy()
    later = times > begin
    along = u - np.sin(2 * np.pi * u) / (2 * np.pi)
    up = LIFT * (1 - np.cos(2 * np.pi * u)) / 2
    feet[later, foot] = (here + along[:, None] * (there - here) + up[:, None] * [0, 0, 1])[later]
    stands[(u > 0) & (u < 1), foot] = False
