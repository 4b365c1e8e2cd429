"""Whether the views that scene/viewpoints/ proposes teach motions better, and whether it knows by how much.

    python tests/benchmarks/viewpoints.py data/table                 # the table world's photographs and field
    python tests/benchmarks/viewpoints.py data/table --rows rows.csv # what is done is kept there: a killed run goes on

Random pairs of the views that the field can show, 20 to 120 degrees apart, the proposed pair, and the pairs nearest to
90 degrees are sketched on by the scripted user, with true cameras (the same hands on all pairs), and fitted, with
teach/density=kernels, which takes a fifth of the flow's time. True error: RMS distance [mm] from the taught mean to the
motion meant at even arc length; its mean over motions and hands. The expected error knows no hands, and of the motions
only the workspace, or, as after a first sketch, where they run.
"""

import argparse
import csv
from functools import partial
from importlib.resources import files
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml
from scipy.stats import spearmanr

from scene import viewpoints
from scene.dataset import load_views
from scene.field import Field
from scene.viewpoints import coverage
from scene.viewpoints.motions import even, motions_in
from teach import hand, rptl, scripted
from teach.curve import resample
from teach.density import Kernels

T = np.linspace(0, 1, 200)
GREEDY = 4
"""Pairs nearest to 90 degrees over which the greedy choice is averaged."""


def places(folder: Path):
    """Candidates, the corners of the workspace, and motions of the kind that proposals rest on."""
    photographed = [view.camera for view in load_views(folder)]
    world = yaml.safe_load(files("conf.world").joinpath("table.yaml").read_text())
    box = coverage.common_box(photographed, *(world["workspace"][side] for side in ("lower", "upper")))
    meant = motions_in(*box)
    return coverage.candidates(photographed, meant, Field.load(folder / "field.pt")), box, meant


def true_motions(box, count: int, rng) -> list[np.ndarray]:
    """Via points (5, 3) [m] of motions within the box, made otherwise than those that proposals rest on."""
    found = []
    while len(found) < count:
        via = rng.uniform(*box) + np.vstack([np.zeros(3), np.cumsum(rng.normal(0, [0.15, 0.15, 0.09], (4, 3)), axis=0)])
        path = scripted.smooth_path(via)
        if (path > box[0]).all() and (path < box[1]).all():
            found.append(via)
    return found


def angles(cameras, middle) -> np.ndarray:
    """(C, C) [deg] between views, seen from ``middle`` (3,) [m]."""
    away = np.stack([camera.centre for camera in cameras]) - middle
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(away @ away.T, -1, 1)))


def random_pairs(apart, count: int, rng) -> list[tuple[int, int]]:
    """Different pairs 20 to 120 degrees apart."""
    allowed = np.argwhere(np.triu((apart >= 20) & (apart <= 120), 1))
    return [tuple(map(int, pair)) for pair in rng.permutation(allowed)[:count]]


def true_error(job, cameras, motions, seed: int) -> tuple:
    """(job, error [mm]) of job = (kind, first, second, motion, hand)."""
    _, first, second, motion, number = job
    truth, person = scripted.smooth_path(motions[motion]), hand.Hand()
    for attempt in range(20):  # a stroke that leaves the picture is drawn again
        rng = np.random.default_rng([seed, motion, number, attempt])
        try:
            drawn = [scripted.sketch(f"view{k}", cameras[k], motions[motion], person, rng)[0] for k in (first, second)]
            taught = rptl.fit(drawn, seed=number, density=Kernels()).distribution.mean_at(T)
            return job, 1e3 * float(np.sqrt(((resample(taught, 200) - truth) ** 2).sum(axis=1).mean()))
        except ValueError:
            continue
    return job, np.nan


def jobs(pairs, greedy, proposed, motions: int, hands: int) -> list[tuple]:
    """Every fit, in an order whose beginnings are balanced."""
    meant = [(m, h) for h in range(hands) for m in range(motions)]
    random = [("random", *pair, *which) for which in meant for pair in pairs]
    right = [("greedy", *pair, *which) for which in meant for pair in greedy]
    ours = [("proposed", *proposed, *which) for which in meant]
    order = [((k + 0.5) / len(part), job) for part in (random, right, ours) for k, job in enumerate(part)]
    return [job for _, job in sorted(order, key=lambda item: item[0])]


def measured(todo, work, rows: Path | None, processes: int) -> dict[tuple, float]:
    """The error of every job; ``rows`` keeps what is done."""
    done = {}
    if rows and rows.exists():
        with rows.open() as file:
            done = {(row[0], *map(int, row[1:5])): float(row[5]) for row in csv.reader(file)}
    with get_context("spawn").Pool(processes) as pool:
        for job, error in pool.imap_unordered(work, [job for job in todo if job not in done]):
            done[job] = error
            if rows:
                with rows.open("a") as file:
                    csv.writer(file).writerow([*job, error])
    return {job: done[job] for job in todo}


def report(errors, cameras, apart, pairs, meant, motions) -> None:
    """motions: (n, POINTS, 3) [m], those that were sketched."""
    rows = {pair: {job[3:]: e for job, e in errors.items() if job[0] == "random" and job[1:3] == pair} for pair in pairs}
    drawn = sorted(set.intersection(*map(set, rows.values())))  # by all hands on every pair, so that pairs can be compared
    each = np.array([[rows[pair][which] for which in drawn] for pair in pairs])
    mean = lambda kind: np.nanmean([e for job, e in errors.items() if job[0] == kind and job[3:] in drawn])
    true = np.nanmean(each, axis=1)
    expect = lambda x: np.array([viewpoints.expected_error([cameras[k] for k in pair], x) for pair in pairs])
    expected, knowing = expect(meant), np.stack([expect(motions[m : m + 1]) for m, _ in drawn], axis=1)
    print(f"{'apart deg':>10}{'expected mm':>13}{'true mm':>10}")
    for k in np.argsort(expected):
        print(f"{apart[pairs[k]]:10.0f}{expected[k]:13.1f}{true[k]:10.1f}")
    failed = int(np.isnan(list(errors.values())).sum())
    print(f"\n{len(errors)} fits, {failed} failed; {len(pairs)} random pairs, on all of them {len(drawn)} motions by hands")
    print(f"rank correlation of expected and true error   {_agreement(expected, true):.2f}")
    print(f"  knowing where the motions run               {_agreement(knowing.mean(axis=1), true):.2f}")
    print(f"  of each motion on each pair, one hand       {_agreement(knowing.ravel(), each.ravel()):.2f}")
    if len(drawn) > 1:
        halves = _agreement(np.nanmean(each[:, ::2], axis=1), np.nanmean(each[:, 1::2], axis=1))
        print(f"  of the true errors of two halves            {halves:.2f}")
    sines = np.sin(np.radians([apart[pair] for pair in pairs]))
    print(f"  of the sine of the angle alone              {_agreement(-sines, true):.2f}")
    print(f"median random pair {np.median(true):.1f} mm, best {true.min():.1f}, worst {true.max():.1f}")
    for kind, title in (("proposed", "the proposed pair"), ("greedy", f"the {GREEDY} pairs nearest to 90 degrees")):
        print(f"{title} {mean(kind):.1f} mm, {mean(kind) / np.median(true):.2f} of it")


def _agreement(expected, true) -> float:
    """Spearman's rank correlation."""
    return spearmanr(expected, true, nan_policy="omit")[0]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path, help="the table world's capture folder, with its field")
    for name, default in (("pairs", 50), ("motions", 6), ("hands", 4), ("seed", 0), ("processes", 2)):
        options.add_argument(f"--{name}", type=int, default=default)
    options.add_argument("--fits", type=int, help="only so many fits, spread over all pairs")
    options.add_argument("--rows", type=Path, help="a file that keeps what is done")
    args = options.parse_args()
    rng = np.random.default_rng([13, args.seed])
    cameras, box, meant = places(args.folder)
    motions, apart = true_motions(box, args.motions, rng), angles(cameras, meant.mean(axis=(0, 1)))
    pairs = random_pairs(apart, args.pairs, rng)
    right = np.argsort(np.abs(np.triu(apart, 1) - 90), axis=None)[:GREEDY]
    greedy = [tuple(map(int, np.unravel_index(k, apart.shape))) for k in right]
    proposal = viewpoints.propose_pair(cameras, meant)
    print(f"{len(cameras)} views. {proposal.why}", flush=True)
    todo = jobs(pairs, greedy, proposal.numbers, args.motions, args.hands)[: args.fits]
    work = partial(true_error, cameras=cameras, motions=motions, seed=args.seed)
    errors = measured(todo, work, args.rows, args.processes)
    report(errors, cameras, apart, pairs, meant, np.stack([even(scripted.smooth_path(via)) for via in motions]))


if __name__ == "__main__":
    main()
