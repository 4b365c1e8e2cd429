"""How well two ways round an obstacle are told apart and learned: three strokes each on two views.

    python tests/benchmarks/routes.py [--seeds 20] [--first 0] [Hydra's overrides]

low: a level motion of 0.4 m, 8 cm to the left or right of an obstacle, seen from 10 to 30 degrees above by random
cameras. away, across, upright: ways round on, towards or over the letters' board, seen by the letters' two cameras. The hand is the
scripted user's. found: share of seeds with two routes; mean, median, worst: Fréchet distance [mm] of a route's mean to what was
meant; alone: the median of ways that are drawn and learned alone, which no telling apart can beat.
"""

import argparse

import numpy as np
from strokes import BOARD, EYES, T, fitter

from scene.camera import Camera, look_at
from teach import scripted
from teach.curve import resample
from teach.hand import Hand
from teach.metrics import frechet
from teach.sketch import Sketch, SketchError

AXES = {"away": (0, 1), "across": (1, 0), "upright": (2, 1)}
"""Which way the motion goes, and to which side the obstacle is passed."""


def scene(kind: str, rng):
    """The via points of both ways and two cameras."""
    target = BOARD + rng.normal(0, 0.04, 3)
    if kind == "low":
        a, azimuths = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi) + np.radians([0, rng.uniform(50, 100)])
        along, side = np.array([np.cos(a), np.sin(a), 0]), np.array([-np.sin(a), np.cos(a), 0])
        eyes = [target + [1.6 * np.cos(b), 1.6 * np.sin(b), rng.uniform(0.3, 0.9)] for b in azimuths]
        cameras = [Camera.from_fov(look_at(eye, target), 640, 480, 60) for eye in eyes]
    else:
        along, side = np.eye(3)[list(AXES[kind])]
        cameras = [Camera([[550, 0, 320], [0, 550, 240], [0, 0, 1]], look_at(eye, BOARD), 640, 480) for eye in EYES[:2]]
    vias = [[target - 0.2 * along, target + s * 0.11 * side, target + 0.2 * along] for s in (-1, 1)]
    return vias, cameras


def drawn(kind: str, seed: int):
    """The paths that are meant, and the sketches; other places are tried until all is in the pictures."""
    for attempt in range(100):
        rng = np.random.default_rng([31, seed, attempt])
        vias, cameras = scene(kind, rng)
        try:
            strokes = [sum((scripted.sketch("", c, via, Hand(), rng)[0].strokes for via in vias), ()) for c in cameras]
        except SketchError:
            continue
        return [scripted.smooth_path(via) for via in vias], [Sketch(f"v{v}", c, s) for v, (c, s) in enumerate(zip(cameras, strokes))]
    raise AssertionError("no motion fits into its pictures")


def _off(distribution, path) -> float:
    return 1000 * float(frechet(resample(distribution.mean_at(T), 200), path))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--kinds", nargs="+", default=["low", *AXES])
    options.add_argument("overrides", nargs="*")
    args = options.parse_intermixed_args()
    fit = fitter(args.overrides)
    print(f"{'':8}{'found':>8}{'mean':>8}{'median':>8}{'worst':>8}{'alone':>8}")
    for kind in args.kinds:
        found, off, alone = [], [], []
        for seed in range(args.first, args.first + args.seeds):
            meant, sketches = drawn(kind, seed)
            routes = fit(sketches, seed=seed).routes
            for way, path in enumerate(meant):
                part = [Sketch(s.view, s.camera, s.strokes[3 * way : 3 * way + 3]) for s in sketches]
                alone.append(_off(fit(part, seed=seed).distribution, path))
            found.append(len(routes) == 2)
            if found[-1]:
                off += [min(_off(route.distribution, path) for route in routes) for path in meant]
        print(f"{kind:8}{np.mean(found):8.2f}{np.mean(off):8.1f}{np.median(off):8.1f}{np.max(off):8.1f}{np.median(alone):8.1f}", flush=True)


if __name__ == "__main__":
    main()
