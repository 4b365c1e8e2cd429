"""When the arm is where: a joint path becomes a motion within velocity and acceleration limits.

The path is a cubic spline over arc length in joint space. TOPP-RA (Pham & Pham 2018) finds the fastest motion along it
from rest to rest. Its samples at the controller's rate are joined by a clamped cubic spline in time: twice continuously
differentiable, which is what is exported and performed. Limits are checked on that spline, and the motion is stretched
in time until they hold.
"""

import logging

import numpy as np
import toppra
from scipy.interpolate import CubicSpline, PchipInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

logging.getLogger("toppra").setLevel(logging.ERROR)

FINER, STALL = (1, 2, 4), 1e-3
"""Grids to try, times as fine, while the motion all but stops on its way (of its largest speed): TOPP-RA's rounding does that next
to an end, where controllable speeds are small."""


def motion_spline(times, joints) -> CubicSpline:
    """The motion between samples: times (T,) [s], joints (T, J); at rest at both ends."""
    return CubicSpline(times, joints, bc_type="clamped")


def time_path(
    path, velocity, acceleration, duration=0.0, rate=50.0, share=0.9
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint path (N, J), limits (J,) [per s, per s^2] -> times (T,) [s], joints (T, J), waypoints (T,).

    duration: at least this long [s]. rate: samples a second [Hz]. share: of the limits that is used. waypoints: where
    on the given path each sample lies, as a fractional index 0 .. N-1. A path that goes nowhere is held for the
    duration. Raises ValueError where no motion along the path keeps the limits.
    """
    path = np.asarray(path, dtype=float)
    kept = _distinct(path)
    if len(kept) < 2:
        count = max(int(np.ceil(max(duration, 1 / rate) * rate)), 1) + 1
        return (
            np.linspace(0, max(duration, 1 / rate), count),
            np.repeat(path[:1], count, axis=0),
            np.linspace(0, len(path) - 1, count),
        )
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path[kept], axis=0), axis=1))])
    spline = CubicSpline(arc, path[kept])
    clock, along = _fastest(spline, arc, share * velocity, share * acceleration)
    to_index = PchipInterpolator(arc, kept)
    longer = max(1.0, duration / clock[-1])
    for _ in range(20):
        times = np.linspace(0, clock[-1] * longer, int(np.ceil(clock[-1] * longer * rate)) + 1)
        position = np.interp(times / longer, clock, along)
        joints = spline(position)
        over = excess(times, joints, velocity, acceleration)
        if over <= 1:
            return times, joints, to_index(position)
        longer *= max(over, 1.01)
    raise ValueError("the path bends too sharply for the velocity and acceleration limits")


def _distinct(path, apart=1e-3) -> np.ndarray:
    """Indices of waypoints at least ``apart`` [rad] from the one kept before, the first and the last among them."""
    kept = [0]
    for k in range(1, len(path)):
        if np.linalg.norm(path[k] - path[kept[-1]]) >= apart:
            kept.append(k)
    if kept[-1] != len(path) - 1 and len(kept) > 1:
        kept[-1] = len(path) - 1
    return np.array(kept)


def _fastest(spline, arc, velocity, acceleration):
    """Dense clock [s] and arc length along the path, from rest to rest."""
    constraints = [
        JointVelocityConstraint(np.column_stack([-velocity, velocity])),
        JointAccelerationConstraint(np.column_stack([-acceleration, acceleration])),
    ]
    path, found = toppra.SplineInterpolator(arc, spline(arc)), []
    for finer in FINER:
        grid = np.linspace(0, arc[-1], finer * max(100, 2 * len(arc)))
        _, speed, _ = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel").compute_parameterization(0, 0)
        if speed is not None and np.isfinite(speed).all():
            mean = np.maximum((speed[:-1] + speed[1:]) / 2, 1e-6)
            found.append((np.concatenate([[0], np.cumsum(np.diff(grid) / mean)]), grid, speed))
            if speed[1:-1].min() > STALL * speed.max():
                break
    if not found:
        raise ValueError("no motion along the path keeps the velocity and acceleration limits")
    knots, grid, speed = min(found, key=lambda one: one[0][-1])
    clock = np.linspace(0, knots[-1], 20 * len(knots))
    return clock, _arc_at(clock, knots, grid, speed)


def _arc_at(clock, knots, grid, speed):
    """Arc length at times: between grid points TOPP-RA's path acceleration is constant."""
    k = np.clip(np.searchsorted(knots, clock, side="right") - 1, 0, len(knots) - 2)
    tau, step = clock - knots[k], knots[k + 1] - knots[k]
    return np.clip(grid[k] + speed[k] * tau + (speed[k + 1] - speed[k]) / step * tau**2 / 2, 0, grid[-1])


def excess(times, joints, velocity, acceleration) -> float:
    """By which factor the motion must be slowed down; at most 1 where it is within the limits."""
    motion = motion_spline(times, joints)
    fine = np.linspace(0, times[-1], 4 * len(times))
    speed = (np.abs(motion(fine, 1)) / velocity).max()
    return max(speed, np.sqrt((np.abs(motion(times, 2)) / acceleration).max()))
