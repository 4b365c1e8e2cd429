"""How well a letter was written: which letter it looks like, and how far it is from what was meant.

The letter begins where a path comes nearest to its first point; what goes before is the way there.
"""

import numpy as np

from robot.letters import STROKES, letter, on_board
from teach.curve import resample
from teach.metrics import frechet
from teach.scripted import smooth_path

POINTS = 100  # at equal arc length


def nearest(path) -> tuple[str, dict[str, float]]:
    """The letter that a path (T, 2), x right and y up, looks like most, and its discrete Frechet distance from each once
    both are of one size and place [of that size]."""
    templates = np.stack([_normed(letter(name)) for name in STROKES])
    far = dict(zip(STROKES, frechet(_normed(path)[None], templates).tolist()))
    return min(far, key=far.get), far


def _normed(path) -> np.ndarray:
    points = resample(np.asarray(path, dtype=float), POINTS)
    low, high = points.min(axis=0), points.max(axis=0)
    return (points - (low + high) / 2) / max((high - low).max(), 1e-9)


def written(motion: dict, performed, planned, meant) -> dict:
    """Metrics of a performed letter. motion: a varied world's, with its letter. performed, planned (T, 3) [m]: the tip's
    paths. meant (S, T, 3) [m]: the paths behind the strokes; the mean of them is the oracle."""
    via = np.array(motion["via"])
    first = via[-len(on_board(motion["letter"], [0, 0, 0], 1.0))]
    done, oracle = _from(performed, first), _from(np.mean(meant, axis=0), first)
    intended = _from(smooth_path(via), first)
    right = np.array(motion.get("right", [0.0, -1.0, 0.0]))
    looks, _ = nearest(np.column_stack([done @ right, done[:, 2]]))
    even = lambda path: resample(path, POINTS)
    return {
        "letter": motion["letter"],
        "looks_like": looks,
        "right": looks == motion["letter"],
        "to_planned_mm": 1e3 * float(frechet(even(performed), even(planned))),
        "to_intended_mm": 1e3 * float(frechet(even(done), even(intended))),
        "oracle_to_intended_mm": 1e3 * float(frechet(even(oracle), even(intended))),
    }


def _from(path, first) -> np.ndarray:
    """The part of a path (T, 3) from where it comes nearest to ``first`` (3,) in its first half."""
    path = np.asarray(path, dtype=float)
    return path[int(np.linalg.norm(path[: len(path) // 2] - first, axis=1).argmin()) :]
