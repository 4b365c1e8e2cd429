"""Where a robot stands in a world: an arm on the thing that its file calls ``mount`` (pedestal), a robot with legs on the floor, its
trunk where the file's ``stand`` has it."""

from dataclasses import replace

import numpy as np


def mounted(spec: dict, arm) -> tuple[dict, object]:
    """(the world's data, the arm) as they are together. A robot with legs has no mount to stand on, and its home, where it
    starts, is turned and shifted to ``stand`` [x, y [m], yaw [deg]]."""
    if arm.legs is None:
        return spec, arm
    mount, variation = spec.get("mount", "pedestal"), dict(spec.get("variation") or {})
    variation["stays"] = [name for name in variation.get("stays", []) if name != mount]
    objects = [thing for thing in spec["objects"] if thing["name"] != mount]
    without = {key: value for key, value in spec.items() if key != "mount"} | {"objects": objects, "variation": variation}
    if not spec.get("stand"):
        return without, arm
    x, y, yaw = spec["stand"]
    return without, replace(arm, home=np.array([x, y, np.radians(yaw), *arm.home[3:]]))
