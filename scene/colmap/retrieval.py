"""Which of many photographs to match with each other: those that look alike, and neighbours in the order of their names.

Notation
    d           a feature's descriptor; words w_k: centres of clusters of descriptors
    v_k         sum of d - w_k over a photograph's descriptors nearest to w_k; all v_k, square-rooted and of unit length,
                say what it shows (VLAD: Jegou et al. 2010)

Matching every pair costs the square of the number of photographs. Alike are partly the most alike and partly ones less so:
of many near-duplicates, the most alike of each are all the same standpoint, and joined to nothing else.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist

SAMPLED = 400
"""Descriptors of a photograph that are looked at."""
ROUNDS = 8
"""Of Lloyd's algorithm."""


def pairs_to_match(
    descriptors: Sequence[np.ndarray], *, alike: int = 20, seed: int = 0, words: int = 64
) -> list[tuple[int, int]]:
    """Pairs (i < j), sorted. descriptors: of each photograph (n_i, D), in the order of names.

    Every photograph is paired with its neighbours 1, 2, 4, 8, ... after it, up to ``alike``, and with ``alike``
    others: the first half of these most alike, the second evenly from those that follow up to four times as many.
    """
    count = len(descriptors)
    steps = [2**k for k in range(max(alike, 1).bit_length())]
    found = {(i, i + step) for i in range(count) for step in steps if i + step < count}
    shown = signatures(descriptors, words, seed)
    unlike = -(shown @ shown.T)
    np.fill_diagonal(unlike, np.inf)
    order = np.argsort(unlike, axis=1, kind="stable")[:, : count - 1]
    near, spread = alike - alike // 2, np.linspace(alike - alike // 2, 4 * alike, alike // 2, dtype=int)
    ranks = [*range(near), *spread]
    found |= {tuple(sorted((i, int(order[i, rank])))) for i in range(count) for rank in ranks if rank < count - 1}
    return sorted(found)


def signatures(descriptors: Sequence[np.ndarray], words: int = 64, seed: int = 0) -> np.ndarray:
    """(photographs, words * D) vectors of unit length, 0 for a photograph without features."""
    rng = np.random.default_rng(seed)
    sampled = [_sample(np.asarray(d, dtype=np.float32), rng) for d in descriptors]
    pool = np.concatenate(sampled)
    if len(pool) == 0:
        return np.zeros((len(sampled), 1))
    centres = _clusters(pool, min(words, len(pool)), rng)
    sums = np.stack([_residuals(d, centres).ravel() for d in sampled])
    sums = np.sign(sums) * np.sqrt(np.abs(sums))
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)


def _sample(d, rng) -> np.ndarray:
    return d[rng.permutation(len(d))[:SAMPLED]]


def _clusters(points, count: int, rng) -> np.ndarray:
    centres = points[rng.permutation(len(points))[:count]]
    for _ in range(ROUNDS):
        nearest = cdist(points, centres, "sqeuclidean").argmin(axis=1)
        sums = np.zeros_like(centres)
        np.add.at(sums, nearest, points)
        sizes = np.bincount(nearest, minlength=count)[:, None]
        centres = np.where(sizes > 0, sums / np.maximum(sizes, 1), centres)
    return centres


def _residuals(d, centres) -> np.ndarray:
    sums = np.zeros_like(centres)
    if len(d):
        nearest = cdist(d, centres, "sqeuclidean").argmin(axis=1)
        np.add.at(sums, nearest, d - centres[nearest])
    return sums
