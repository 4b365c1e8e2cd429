"""How near a motion comes that was drawn exactly: how far geometry alone leads, whatever the speed and the cameras.

    python tests/benchmarks/exact.py [--seeds 20] [--first 0] [--modes exact own noise hand] [--strokes 1 2 3] [Hydra's overrides]

Random smooth motions of about 0.4 m, seen by two cameras 20 to 120 degrees apart. exact: projected, at an even speed. own: at
a speed of its own. noise: and trembling by 1.5 px. hand: drawn by ``teach.hand.Hand``. Fréchet distance [mm] of the mean to
what was meant, over motions that geometry determines (clear) and those largely level with both cameras (level); px: the
furthest that a point of a stroke is from the mean's picture; inside: share of the times at which the motion runs
through the 95 % region of the skill.
"""

import argparse

import numpy as np
from strokes import BOARD, T, fitter

from scene.camera import Camera, look_at
from teach import scripted
from teach.curve import resample
from teach.hand import Hand, own_speed, tremor
from teach.metrics import frechet
from teach.quality import LEVEL, level
from teach.sketch import Sketch, SketchError, Stroke

CROSSED = 5.99
"""Squared Mahalanobis distance of 95 % of what is off across a curve, in two dimensions."""


def scene(rng):
    """Via points, the path through them (200, 3) [m], two cameras; other places are tried until all is in the pictures."""
    while True:
        via = 0.15 * np.cumsum(rng.normal(0, 1, (rng.integers(3, 6), 3)), axis=0) * [1, 1, rng.choice([1, 1, 0.2])]
        via += BOARD - via.mean(axis=0)
        azimuths = rng.uniform(0, 2 * np.pi) + np.array([0, np.radians(rng.uniform(20, 120))])
        heights = rng.uniform(0.15, 1.0, 2)
        ways = np.stack([np.cos(azimuths) * np.cos(heights), np.sin(azimuths) * np.cos(heights), np.sin(heights)], axis=1)
        eyes = BOARD + rng.uniform(1.2, 2.0, (2, 1)) * ways
        cameras = [Camera.from_fov(look_at(eye, BOARD), 640, 480, 60) for eye in eyes]
        path = scripted.smooth_path(via)
        if all(camera.contains(camera.project(path)).all() for camera in cameras):
            return via, path, cameras


def drawn(path, camera, mode: str, rng) -> Stroke:
    """The path's picture, at 40 to 400 points."""
    along = np.linspace(0, 1, int(rng.integers(40, 400)))
    times = along if mode == "exact" else own_speed(len(along), 0.6, 6, rng)
    points = np.stack([np.interp(along, T, axis) for axis in camera.project(path).T], axis=1)
    if mode == "noise":
        points = points + tremor(along * 3, 1.5, 0.04, rng)
    return Stroke(points, 3 * times)


def case(seed: int, mode: str, strokes: int):
    """The path that is meant, the cameras and the sketches."""
    for attempt in range(100):
        rng = np.random.default_rng([37, seed, attempt])
        via, path, cameras = scene(rng)
        try:
            if mode == "hand":
                sketches = [scripted.sketch(f"v{v}", c, via, Hand(), rng, strokes)[0] for v, c in enumerate(cameras)]
            else:
                sketches = [
                    Sketch(f"v{v}", c, tuple(drawn(path, c, mode, rng) for _ in range(strokes))) for v, c in enumerate(cameras)
                ]
        except SketchError:
            continue
        return path, cameras, sketches
    raise AssertionError("no motion fits into its pictures")


def strayed(sketches, mean) -> float:
    """Largest distance [px] of a point of a stroke from the picture of the mean (T, 3)."""
    return max(
        float(np.linalg.norm(stroke.points[:, None] - sketch.camera.project(mean), axis=-1).min(axis=1).max())
        for sketch in sketches
        for stroke in sketch.motions
    )


def crossed(distribution, path) -> float:
    """Share of times at which the path (N, 3) runs through the 95 % region of the distribution."""
    t = np.linspace(0, 1, 50)
    off = resample(path, 1000)[None] - distribution.mean_at(t)[:, None]
    inverse = np.linalg.inv(distribution.covariance_at(t) + 1e-9 * np.eye(3))
    return float((np.einsum("tna,tab,tnb->tn", off, inverse, off).min(axis=1) <= CROSSED).mean())


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--modes", nargs="+", default=["exact", "own", "noise", "hand"])
    options.add_argument("--strokes", nargs="+", type=int, default=[1, 2, 3])
    options.add_argument("overrides", nargs="*")
    args = options.parse_intermixed_args()
    fit = fitter(args.overrides)
    names = ("clear", "worst", "level", "worst", "px", "worst", "inside", "s")
    print(f"{'':8}{'strokes':>8}" + "".join(f"{name:>8}" for name in names))
    for mode in args.modes:
        for strokes in args.strokes:
            rows = []
            for seed in range(args.first, args.first + args.seeds):
                path, cameras, sketches = case(seed, mode, strokes)
                skill = fit(sketches, seed=seed)
                mean = skill.distribution.mean_at(T)
                off = 1000 * frechet(resample(mean, 200), resample(path, 200))
                share = level(cameras, path).mean()
                rows.append((share, off, strayed(sketches, mean), crossed(skill.distribution, path), skill.report["seconds"]))
            share, off, px, inside, seconds = np.array(rows).T
            halves = [off[share < LEVEL], off[share >= LEVEL]]
            summary = [f(half) if len(half) else np.nan for half in halves for f in (np.median, np.max)]
            summary += [np.median(px), px.max(), inside.mean(), np.median(seconds)]
            print(f"{mode:8}{strokes:8d}" + "".join(f"{value:8.2f}" for value in summary), flush=True)


if __name__ == "__main__":
    main()
