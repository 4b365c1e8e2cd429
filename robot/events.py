"""When the events of a skill happen along a plan: at the same share of the way.

The plan's timing is its own (it is as fast as the arm allows); what a skill and a plan have in common is the path, once
the hand is where it begins.
"""

import numpy as np

from teach.sketch import Event

POINTS = 400


def planned_events(skill, plan) -> tuple[Event, ...]:
    """The skill's events at times [s] of the plan, in order. skill: Skill. plan: Plan made from it."""
    if not skill.events:
        return ()
    t, begun = np.linspace(0, 1, POINTS), plan.times >= plan.begins
    times, tip = plan.times[begun], plan.tip[begun]
    taught = _travelled(skill.starting_at(tip[0])[plan.way].distribution.mean_at(t))
    performed = _travelled(tip)
    shares = [float(np.interp(event.time / skill.duration, t, taught)) for event in skill.events]
    found = [Event(event.name, float(np.interp(share, performed, times))) for event, share in zip(skill.events, shares)]
    return tuple(sorted(found, key=lambda event: event.time))


def _travelled(path) -> np.ndarray:
    """(T,) share of the way along a path (T, 3), strictly growing but for rounding."""
    far = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1) + 1e-9)])
    return far / far[-1]
