"""What the arm keeps out of beside bodies: outlined regions and boxes, for the whole arm or for some of its links.

    keep_out: [{name: shelf, lower: [0.4, -0.2, 0.5], upper: [0.6, 0.2, 0.7], links: [panda_link4]}]     metres, world frame
"""

from itertools import product

import numpy as np
from scipy.spatial import ConvexHull

from teach.hull import Region, visual_hull


def regions_of(outlines, outlined_for, boxes) -> tuple[list[Region], dict[str, tuple[str, ...]]]:
    """The regions of keep-out outlines (Sketches) and of boxes, and {name: links} of those that bind only these links."""
    drawn = visual_hull(outlines)
    only = {region.name: tuple(outlined_for) for region in drawn if outlined_for is not None}
    only |= {box["name"]: tuple(box["links"]) for box in boxes if box.get("links") is not None}
    return [*drawn, *map(box_region, boxes)], only


def box_region(box) -> Region:
    """A Region from a box's mapping {name, lower, upper, links}. Raises ValueError where that is not one."""
    lower, upper = corners_of({key: value for key, value in box.items() if key != "links"})
    corners = np.where(np.array(list(product((False, True), repeat=3))), upper, lower)
    return Region(box["name"], ((corners, ConvexHull(corners).simplices),))


def corners_of(box) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) [m] of a box's mapping {name, lower, upper}. Raises ValueError where that is not one."""
    if {"name", "lower", "upper"} != set(box):
        raise ValueError(f"a box has a name, lower and upper (and one to keep out of perhaps links), not {', '.join(map(str, box))}")
    lower, upper = (np.array(box[key], dtype=float) for key in ("lower", "upper"))
    if lower.shape != (3,) or upper.shape != (3,) or not (lower < upper).all():
        raise ValueError(f"the box {box['name']} must have lower below upper, three numbers each [m]")
    return lower, upper
