"""Plan: a motion of the arm as it will be performed, with what was checked about it; its files."""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from robot.attempt import title
from robot.timing import excess, motion_spline
from scene.files import parse_npz, replacing


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion and what was checked about it; at rest at both ends, the first row is the present state.

    times (T,) [s]. joints (T, J) [rad]. names: of the joints. position_error (T,) [m]: tip against the candidate
    followed. clearance (T,) [m]: to the world and the skill's keep-out regions, at most 0.3. self_clearance (T,) [m]: of
    the arm to itself. tip (T, 3)
    [m]. refusals: a sentence for each refused candidate. samples: candidates tried. chosen: which is followed, 0 is the
    mean. way: of the skill's ways the one that is followed, the most usual is 0. feasible: whether the
    motion passed every check; where False, ``joints`` are the least bad candidate, not to be performed. begins [s]: when the
    taught motion does, after the way to where it begins. stands: where the robot goes to stand first, or would have to, and why.
    ends: where the taught end was out of reach, how far before it the motion ends. slow: where the taught motion takes very much longer than it was drawn, how long. touch (3,) [m]: where the hand is to touch at its
    end, nan where it is not to; contact (3,) [m] and fingers (G,): of the hand that does, see contact.py; ``tip`` is its contact point.
    """

    times: np.ndarray
    joints: np.ndarray
    names: tuple[str, ...]
    position_error: np.ndarray
    clearance: np.ndarray
    self_clearance: np.ndarray
    tip: np.ndarray
    refusals: tuple[str, ...]
    samples: int
    chosen: int
    feasible: bool
    way: int = 0
    moved: str = ""
    begins: float = 0.0
    stands: str = ""
    slow: str = ""
    ends: str = ""
    touch: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    contact: np.ndarray = field(default_factory=lambda: np.zeros(3))
    fingers: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def touches(self) -> bool:
        return bool(np.isfinite(self.touch).all())

    @property
    def sentence(self) -> str:
        """What came of it, in one line."""
        if not self.feasible:
            more = "".join(f"; {said}" for said in (self.moved, self.ends, self.stands) if said)
            return f"none of {self.samples} candidates is feasible; {self.refusals[self.chosen]}{more}"
        which = (title(self.chosen) if self.chosen >= 0 else self.moved) + f" (way {self.way + 1})" * (self.way > 0)
        feasible, clear, error = (
            self.samples - len(self.refusals),
            1e3 * self.clearance.min(),
            1e3 * self.position_error.max(),
        )
        return (
            f"{which} is taken, {feasible} of {self.samples} candidates are feasible: {self.times[-1]:.1f} s, "
            f"at least {clear:.0f} mm clear of the world, position within {error:.2f} mm"
        ) + "".join(f"; {said}" for said in (self.ends, self.slow, self.stands) if said)

    def joint_trajectory(self) -> dict:
        """In the layout of ROS 2's trajectory_msgs/JointTrajectory; the first point is the present state."""
        motion = motion_spline(self.times, self.joints)
        rows = zip(self.times, self.joints, motion(self.times, 1), motion(self.times, 2))
        points = [
            {
                "positions": q.tolist(),
                "velocities": v.tolist(),
                "accelerations": a.tolist(),
                "effort": [],
                "time_from_start": dict(zip(("sec", "nanosec"), divmod(round(1e9 * t), 10**9))),
            }
            for t, q, v, a in rows
        ]
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        return {"header": header, "joint_names": list(self.names), "points": points}

    def save(self, path) -> None:
        """Write an npz file, whole or not at all."""
        words = ("names", "refusals", "moved", "stands", "slow", "ends")
        values = {f.name: np.array(getattr(self, f.name), dtype=str if f.name in words else None) for f in fields(self)}
        with replacing(path) as temporary:
            np.savez(temporary, **values)

    @classmethod
    def load(cls, path) -> "Plan":
        """Read what ``save`` wrote. Raises FileNotFoundError, or ValueError for any other file."""
        return parse_npz(path, "a plan file", "robot.plan", cls._parsed)

    @classmethod
    def _parsed(cls, arrays) -> "Plan":
        later = {"way": np.array(0), "moved": np.array(""), "begins": np.array(0.0), "stands": np.array(""), "slow": np.array(""), "ends": np.array(""),
                 "touch": np.full(3, np.nan), "contact": np.zeros(3), "fingers": np.zeros(0)}  # earlier files have none
        values = {f.name: (later | arrays)[f.name] for f in fields(cls)}
        words = {name: tuple(values[name].tolist()) for name in ("names", "refusals")}
        numbers = {name: values[name].item() for name in ("samples", "chosen", "feasible", "way", "moved", "begins", "stands", "slow", "ends")}
        return cls(**values | words | numbers)

    def after(self, lead, velocity, acceleration) -> "Plan":
        """The same motion after another Plan that ends where this one begins; slowed down where the joint asks for it."""
        times = np.concatenate([lead.times, lead.times[-1] + self.times[1:]])
        joined = lambda name: np.concatenate([getattr(lead, name), getattr(self, name)[1:]])
        slower = max(1.0, excess(times, joined("joints"), velocity, acceleration))
        rows = {name: joined(name) for name in ("joints", "position_error", "clearance", "self_clearance", "tip")}
        return replace(self, times=slower * times, begins=slower * float(lead.times[-1] + self.begins), **rows)
