"""Cost of learning as views, strokes and their points grow: seconds and peak memory, each case in a process of its own.

    python tests/benchmarks/growth.py                               # the default
    python tests/benchmarks/growth.py teach/rptl=paper --views 2     # Hydra's overrides
    python tests/benchmarks/growth.py --profile 10 10 1000          # where the time of one case goes

The least that holds: 10 views x 10 strokes x 1000 points within 20 s and 1.5 GB. The motion is a random one in space;
views lie round it, strokes are those of ``teach.hand.Hand``. Seconds are those of teach.rptl.fit, memory is the whole
process's.
"""

import argparse
import resource
import subprocess
import sys
import time
from itertools import product

import numpy as np

from scene.camera import Camera, look_at
from teach.curve import mean_curve
from teach.hand import Hand
from teach.metrics import frechet
from teach.scripted import sketch, smooth_path

TARGET = np.array([0.55, 0.0, 0.45])
VIEWS, STROKES, POINTS = (2, 4, 10), (3, 10), (100, 1000)


def sketches(views: int, strokes: int, points: int, seed: int = 0):
    """``strokes`` strokes of ``points`` points on each of ``views`` views, and the path that is meant (T, 3) [m]."""
    rng = np.random.default_rng(seed)
    via = 0.15 * np.cumsum(rng.normal(0, 1, (5, 3)), axis=0)
    via += TARGET - via.mean(axis=0)
    angles = np.radians(30 + 270 * np.arange(views) / views)
    heights = TARGET[2] + 0.3 + 0.4 * (np.arange(views) % 2)
    eyes = np.stack([TARGET[0] + 2 * np.cos(angles), TARGET[1] + 2 * np.sin(angles), heights], axis=1)
    cameras = [Camera.from_fov(look_at(eye, TARGET), 640, 480, 60) for eye in eyes]
    person = Hand(duration=(2.0, 2.0), rate=(points - 1) / 2.0)
    drawn = [sketch(f"view{v}", c, via, person, rng, count=strokes)[0] for v, c in enumerate(cameras)]
    return drawn, smooth_path(via)


def measure(views: int, strokes: int, points: int, overrides) -> None:
    """Print seconds, peak memory [GB] and error [mm] of this process."""
    from strokes import fitter

    drawn, path = sketches(views, strokes, points)
    fit = fitter(overrides)
    started = time.perf_counter()
    skill = fit(drawn, seed=0)
    seconds = time.perf_counter() - started
    error = 1000 * frechet(mean_curve([skill.distribution.mean_at(np.linspace(0, 1, 200))], 200), path)
    print(seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, error)


def profile(views: int, strokes: int, points: int, overrides) -> None:
    """Print the functions of this house in which the time goes."""
    import cProfile
    import pstats

    from strokes import fitter

    drawn, _ = sketches(views, strokes, points)
    fit, timed = fitter(overrides), cProfile.Profile()
    timed.runcall(fit, drawn, seed=0)
    pstats.Stats(timed).sort_stats("cumulative").print_stats("teach|scene", 30)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, nargs="+", default=VIEWS)
    parser.add_argument("--strokes", type=int, nargs="+", default=STROKES)
    parser.add_argument("--points", type=int, nargs="+", default=POINTS)
    one = dict(type=int, nargs=3, metavar=("VIEWS", "STROKES", "POINTS"))
    parser.add_argument("--measure", **one, help="a single case, in this process: seconds, GB, mm")
    parser.add_argument("--profile", **one)
    parser.add_argument("overrides", nargs="*", help="Hydra's overrides")
    args = parser.parse_intermixed_args()
    if args.measure or args.profile:
        return (measure if args.measure else profile)(*(args.measure or args.profile), args.overrides)
    print("".join(f"{name:>8}" for name in ("views", "strokes", "points", "s", "GB", "mm")))
    for case in product(args.views, args.strokes, args.points):
        command = [sys.executable, __file__, "--measure", *map(str, case), *args.overrides]
        ran = subprocess.run(command, capture_output=True, text=True)
        if ran.returncode:
            sys.exit(ran.stderr)
        seconds, memory, error = map(float, ran.stdout.split())
        print("".join(f"{value:8d}" for value in case) + f"{seconds:8.1f}{memory:8.2f}{error:8.1f}", flush=True)


if __name__ == "__main__":
    main()
