"""Letters to write on an upright board: each a single stroke without lifting.

A letter lives in a unit square, x to the writer's right and y up, and begins where the pen is set down. It is written on
a plane across x of the robot's frame, the writer looking along +x: right is -y there, up is z.
"""

import numpy as np

STROKES = {
    "A": "0,0 0.5,1 1,0 0.78,0.42 0.22,0.42",
    "B": "0,0 0,1 0.55,1 0.8,0.9 0.82,0.7 0.6,0.54 0.05,0.52 0.65,0.5 0.95,0.36 0.97,0.14 0.7,0 0.02,0.01",
    "C": "0.95,0.82 0.7,0.98 0.4,1 0.12,0.82 0,0.5 0.12,0.18 0.4,0 0.7,0.02 0.95,0.18",
    "D": "0,0 0,1 0.5,1 0.85,0.82 1,0.5 0.85,0.18 0.5,0 0.02,0",
    "E": "0.95,1 0,1 0,0.52 0.75,0.5 0.02,0.48 0,0 0.95,0",
    "F": "0.95,1 0,1 0,0.52 0.7,0.5 0.02,0.48 0,0",
    "G": "0.95,0.82 0.7,0.98 0.4,1 0.12,0.82 0,0.5 0.12,0.18 0.4,0 0.75,0.02 0.97,0.2 0.97,0.45 0.55,0.46",
    "H": "0,1 0,0 0.01,0.5 0.99,0.5 1,1 1,0",
    "I": "0.5,1 0.5,0",
    "J": "0.8,1 0.8,0.3 0.65,0.06 0.4,0 0.15,0.08 0.05,0.3",
    "K": "0,1 0,0 0.01,0.45 0.9,1 0.25,0.58 0.95,0",
    "L": "0,1 0,0 0.9,0",
    "M": "0,0 0.08,1 0.5,0.3 0.92,1 1,0",
    "N": "0,0 0,1 1,0 1,1",
    "O": "0.5,1 0.15,0.85 0,0.5 0.15,0.15 0.5,0 0.85,0.15 1,0.5 0.85,0.85 0.52,1",
    "P": "0,0 0,1 0.6,1 0.9,0.9 0.95,0.72 0.85,0.54 0.55,0.46 0.02,0.46",
    "Q": "0.5,1 0.15,0.85 0,0.5 0.15,0.15 0.5,0 0.85,0.15 1,0.5 0.85,0.85 0.5,1 0.75,0.9 0.9,0.7 0.62,0.3 1,-0.05",
    "R": "0,0 0,1 0.6,1 0.9,0.9 0.93,0.72 0.8,0.55 0.1,0.5 0.4,0.48 0.95,0",
    "S": "0.92,0.85 0.7,0.98 0.4,1 0.12,0.9 0.08,0.7 0.3,0.55 0.7,0.45 0.92,0.3 0.88,0.1 0.6,0 0.3,0.02 0.05,0.15",
    "T": "0,1 1,1 0.5,0.98 0.5,0",
    "U": "0,1 0,0.35 0.12,0.1 0.5,0 0.88,0.1 1,0.35 1,1",
    "V": "0,1 0.5,0 1,1",
    "W": "0,1 0.22,0 0.5,0.7 0.78,0 1,1",
    "X": "0,1 1,0 0.5,0.5 1,1 0,0",
    "Y": "0,1 0.5,0.5 1,1 0.5,0.5 0.5,0",
    "Z": "0,1 1,1 0,0 1,0",
}
STRAIGHT = 0.25  # of the letter's size: points of a straight line are at most this far apart
CORNER = 0.03  # of the letter's size: a corner is rounded within this


def letter(name: str) -> np.ndarray:
    """The stroke (N, 2) of a letter. Raises ValueError for what is none."""
    if str(name) not in STROKES:
        raise ValueError(f"no letter {name!r}; there are {', '.join(STROKES)}")
    return np.array([[float(x) for x in point.split(",")] for point in STROKES[name].split()])


def on_board(name: str, centre, size: float) -> np.ndarray:
    """Via points (V, 3) [m] of a letter ``size`` [m] high on the plane through ``centre`` (3,): each corner is two points, and
    straight lines have points enough to stay straight when they are joined smoothly."""
    drawn = letter(name) - 0.5
    steps = np.diff(drawn, axis=0)
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    points = [drawn[:1]]
    for k, here in enumerate(drawn[1:-1]):
        turned_back = int(along[k] @ along[k + 1] < -0.9)
        points += [here - CORNER * along[k], *[here] * turned_back, here + CORNER * along[k + 1]]
    corners = np.vstack([*points, drawn[-1]])
    flat = size * np.vstack([_filled(a, b) for a, b in zip(corners, corners[1:])] + [corners[-1:]])
    return np.asarray(centre, dtype=float) + np.column_stack([np.zeros(len(flat)), -flat[:, 0], flat[:, 1]])


def _filled(a, b) -> np.ndarray:
    """Points from a on, without b, at most STRAIGHT apart."""
    count = int(np.ceil(np.linalg.norm(b - a) / STRAIGHT))
    return a + np.arange(count)[:, None] / count * (b - a)
