"""Strokes against the real thing: our default from strokes on two views, and a ProMP (Paraschos et al. 2013) of
movement_primitives taught by the 3D demonstrations themselves, those the strokes' makers had in mind.

    pip install movement_primitives
    python tests/benchmarks/promp.py letters ../shared/data/strokes --seeds 2
    python tests/benchmarks/promp.py scripted --seeds 30 --modes own

Columns are those of strokes.py. The ProMP is given all that strokes withhold: the third dimension, and common time (its
demonstrations are at equal arc length). It has as many basis functions, and its own EM.
"""

from types import SimpleNamespace

import numpy as np
from strokes import T, cases, fitter, heading, line, mean_scores, parsed, parser, resample, scores

try:
    from movement_primitives.promp import ProMP
except ImportError:
    raise SystemExit("error: this benchmark needs movement_primitives: pip install movement_primitives") from None

WEIGHTS = 20


class Imitated:
    """A ProMP with those methods of TrajectoryDistribution that are scored. demonstrations: (n, N, 3) [m]."""

    def __init__(self, demonstrations):
        self.promp = ProMP(n_dims=3, n_weights_per_dim=WEIGHTS)
        times = np.tile(np.linspace(0, 1, demonstrations.shape[1]), (len(demonstrations), 1))
        self.promp.imitate(times, demonstrations)

    def mean_at(self, t) -> np.ndarray:
        return self.promp.mean_trajectory(t)

    def covariance_at(self, t) -> np.ndarray:
        """(T, 3, 3) [m^2] of (3T, 3T), in which the axis comes first."""
        return np.einsum("atbt->tab", self.promp.cov_trajectory(t).reshape(3, len(t), 3, len(t)))

    def sample(self, n: int, t, rng) -> np.ndarray:
        return self.promp.sample_trajectories(t, n, np.random.RandomState(rng.integers(2**31)))


def imitate(training):
    """fit(sketches, seed=) that looks at the 3D demonstrations (list of (N, 3) [m]) instead."""
    demonstrations = np.stack([resample(path, len(T)) for path in training])
    return lambda sketches, seed: SimpleNamespace(distribution=Imitated(demonstrations))


def main() -> None:
    args, overrides, folders = parsed(parser(__doc__))
    for mode in args.modes:
        every = list(cases(args.protocol, mode, args.seeds, *folders))
        print(heading(mode, 16))
        print("\r" + line("strokes, ours", mean_scores(fitter(overrides), every), 16), flush=True)
        taught = [scores(imitate(training), seed, sketches, seen, training, all_paths)
                  for _, seed, sketches, seen, training, all_paths in every]  # fmt: skip
        print(line("3D, ProMP", np.mean(taught, axis=0), 16), flush=True)


if __name__ == "__main__":
    main()
