"""How well motions are learned from strokes, over what the strokes' own 3D paths allow (the oracle).

    python tests/benchmarks/strokes.py letters ../shared/data/strokes        # letters drawn by a person on a board
    python tests/benchmarks/strokes.py scripted                              # random motions, cameras and hands
    python tests/benchmarks/strokes.py letters DIR teach.rptl.time=arc_length teach/rptl=paper    # Hydra's overrides

Letters: 18 units are 0.30 m on a board at (0.55, 0, 0.45) m, x = 0.55; strokes 1-3 are seen by the first camera, 4-6 by
the second, 7-9 by a third, held out. MFD and WD are over the picture's width; "x" is the ratio to the oracle, the mean
of the training strokes' 3D paths (five of them as samples). "own": every stroke drawn at a speed of its own.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_module
from hydra.utils import instantiate
from scipy.io import loadmat

from scene.camera import Camera, look_at
from teach import hand, metrics, scripted
from teach.curve import mean_curve, resample
from teach.sketch import Sketch, Stroke

T = np.linspace(0, 1, 200)
BOARD = np.array([0.55, 0.0, 0.45])
EYES = ((-0.25, -0.75, 0.75), (-0.25, 0.75, 0.75), (-0.45, 0.05, 0.40))
DRAWS = 50
"""Draws of five samples over which WD is averaged."""
COLUMNS = ("MFD x", "WD x", "3D mm", "oracle", "inside", "area x", "s")


def letters(folder: Path, mode: str, seeds):
    """(title, sketches, held-out Sketch, training paths, all paths) of each letter and seed."""
    cameras = [Camera([[550, 0, 320], [0, 550, 240], [0, 0, 1]], look_at(eye, BOARD), 640, 480) for eye in EYES]
    for path in sorted(folder.glob("*.mat")):
        flat = [demo["pos"][0, 0].T * 0.30 / 18 for demo in loadmat(path)["demos"][0][:9]]
        paths = [BOARD + np.column_stack([0 * x[:, 0], -x[:, 0], x[:, 1]]) for x in flat]
        for seed in seeds:
            rng = np.random.default_rng(seed)
            drawn = [_replayed(cameras[k // 3].project(x), mode, rng) for k, x in enumerate(paths)]
            sketches = [Sketch(f"view{v + 1}", c, tuple(drawn[3 * v : 3 * v + 3])) for v, c in enumerate(cameras)]
            yield path.stem, seed, sketches[:2], sketches[2], paths[:6], paths


def scripted_motions(mode: str, seeds):
    """Random smooth motions in space, seen by random cameras, drawn by ``teach.hand.Hand``."""
    for seed in seeds:
        rng = np.random.default_rng([7, seed])
        target = BOARD + rng.normal(0, 0.05, 3)
        kind = ("space", "table", "level")[seed % 3]  # level: in the plane of the first two cameras' centres
        via = target + 0.15 * np.cumsum(rng.normal(0, 1, (5, 3)), axis=0) * [1, 1, {"space": 1}.get(kind, 0.05)]
        via += target - via.mean(axis=0)
        height = target[2] + (0.02 if kind == "level" else rng.uniform(0.3, 0.9))
        azimuths = rng.uniform(0, 360) + np.array([0, rng.uniform(50, 100), rng.uniform(-80, -30)])
        eyes = [[target[0] + 1.6 * np.cos(a), target[1] + 1.6 * np.sin(a), height] for a in np.radians(azimuths)]
        eyes[2][2] = target[2] + 0.7
        cameras = [Camera.from_fov(look_at(eye, target), 640, 480, 60) for eye in eyes]
        person = hand.Hand(tremor=0.001, speed=(0.0, 0.0) if mode == "drawn" else (0.6, 0.6))
        try:
            drawn = [scripted.sketch(f"view{v + 1}", c, via, person, rng, first=3 * v) for v, c in enumerate(cameras)]
        except ValueError:
            continue  # outside of a picture
        paths = np.concatenate([intended for _, intended in drawn])
        sketches = [sketch for sketch, _ in drawn]
        yield kind, seed, sketches[:2], sketches[2], list(paths[:6]), [scripted.smooth_path(via)]


def _replayed(pixels, mode: str, rng) -> Stroke:
    if mode == "drawn":
        return Stroke(pixels, np.linspace(0, 2, len(pixels)))
    even = resample(pixels, 400)
    passed, times = hand.own_speed(400, 0.6, 6, rng), np.linspace(0, 1, len(pixels))
    return Stroke(np.stack([np.interp(times, passed, axis) for axis in even.T], axis=1), 2 * times)


def scores(fit, seed, sketches, held_out, training, everything) -> list[float]:
    """One row of COLUMNS."""
    started = time.perf_counter()
    skill = fit(sketches, seed=seed)
    seconds = time.perf_counter() - started
    d, camera, rng = skill.distribution, held_out.camera, np.random.default_rng(seed)
    see, width = camera.project, camera.width
    strokes = [stroke.points for stroke in held_out.strokes]
    mean, oracle = d.mean_at(T), np.stack([resample(x, 200) for x in training])
    draws = [metrics.wd(see(d.sample(5, T, rng)), strokes, width) for _ in range(DRAWS)]
    ours = metrics.mfd(see(mean), strokes, width)[0], np.mean(draws)
    best = metrics.mfd(see(oracle.mean(0)), strokes, width)[0], metrics.wd(see(oracle[:5]), strokes, width)
    truth = mean_curve(everything, 200)
    error, least = (1000 * metrics.frechet(resample(x, 200), truth) for x in (mean, oracle.mean(0)))
    tube = see(mean), _seen(camera, mean, d.covariance_at(T))
    flat = np.stack([see(x) for x in oracle])
    flat_mean, off = flat.mean(0), flat - flat.mean(0)
    oracle_area = metrics.region_area(flat_mean, np.einsum("nta,ntb->tab", off, off) / (len(off) - 1) + 1e-6 * np.eye(2))
    return [
        ours[0] / best[0], ours[1] / best[1], error, least,
        metrics.coverage(strokes, *tube), metrics.region_area(*tube) / oracle_area, seconds,
    ]  # fmt: skip


def _seen(camera, points, covariance) -> np.ndarray:
    """Covariance (T, 2, 2) [px^2] of points (T, 3) with covariance (T, 3, 3) in a picture, to first order."""
    J = camera.jacobian(points)
    return J @ covariance @ J.swapaxes(1, 2) + 1e-6 * np.eye(2)


def fitter(overrides=()):
    """fit(sketches, seed=) -> Skill with the settings that Hydra's overrides give."""
    with initialize_config_module("conf", version_base=None):
        cfg = compose("config", overrides=list(overrides))
    parts = {part: instantiate(cfg.teach[part]) for part in ("density", "raytrace", "basis")}
    return lambda sketches, seed: instantiate(cfg.teach.rptl)(sketches, seed=seed, **parts)


def cases(protocol: str, mode: str, seeds: int, folder=None):
    """What ``letters`` or ``scripted_motions`` yield; seeds 0: 5 for letters, 30 for scripted ones."""
    if protocol == "letters":
        return letters(Path(folder), mode, range(seeds or 5))
    return scripted_motions(mode, range(seeds or 30))


def mean_scores(fit, each) -> np.ndarray:
    """The mean row of COLUMNS over cases, with a dot on stderr for each."""
    rows = []
    for _, seed, *case in each:
        rows.append(scores(fit, seed, *case))
        print(".", end="", file=sys.stderr, flush=True)
    return np.mean(rows, axis=0)


def heading(title: str, width: int = 8) -> str:
    return f"{title:{width}}" + "".join(f"{name:>8}" for name in COLUMNS)


def line(title: str, row, width: int = 8) -> str:
    return f"{title:{width}}" + "".join(f"{value:8.3f}" for value in row)


def parser(doc: str) -> argparse.ArgumentParser:
    """What these benchmarks are asked for on the command line."""
    options = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("protocol", choices=("letters", "scripted"))
    options.add_argument("--seeds", type=int, default=0, help="5 for letters, 30 for scripted")
    options.add_argument("--modes", nargs="+", default=["drawn", "own"])
    options.add_argument("rest", nargs="*", help="the folder of letters; Hydra's overrides")
    return options


def parsed(options: argparse.ArgumentParser) -> tuple[argparse.Namespace, list[str], list[str]]:
    """The arguments, Hydra's overrides among them, and the folders."""
    args = options.parse_intermixed_args()
    return args, [x for x in args.rest if "=" in x], [x for x in args.rest if "=" not in x]


def main() -> None:
    args, overrides, folders = parsed(parser(__doc__))
    fit = fitter(overrides)
    for mode in args.modes:
        rows: dict[str, list] = {}
        for title, seed, *case in cases(args.protocol, mode, args.seeds, *folders):
            rows.setdefault(title, []).append(scores(fit, seed, *case))
            print(".", end="", file=sys.stderr, flush=True)
        print("\n" + heading(mode))
        rows["mean"] = [row for each in rows.values() for row in each]
        for title, each in rows.items():
            print(line(title, np.mean(each, axis=0)))


if __name__ == "__main__":
    main()
