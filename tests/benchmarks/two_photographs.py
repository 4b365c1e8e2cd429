"""Two tagged photographs and no NeRF: how near cameras come by tags alone, and what that costs a taught motion.

    python tests/benchmarks/two_photographs.py data/table --pairs 10

Pairs of a simulated capture's photographs, 40 to 120 degrees apart, whose cameras tags alone give (scene.resection); a scripted hand
draws three strokes on each with the true camera, and the motion is fitted with true, COLMAP's and the tags' cameras.
"""

import argparse
import itertools
import json
import tempfile
from pathlib import Path

import numpy as np

from scene.camera import Camera
from scene.dataset import load_views
from scene.frame.apriltag import TagLayout
from scene.resection import resect
from teach import rptl, scripted
from teach.hand import Hand
from teach.sketch import Sketch

T = np.linspace(0, 1, 100)


def pairs(cameras, target, via, rng):
    """Pairs that see the whole motion, with room beside it, in random order."""
    sees = lambda camera: (np.abs(camera.project(via) / [camera.width, camera.height] - 0.5) < 0.4).all()
    names = [n for n in cameras if sees(cameras[n])]
    towards = {n: (cameras[n].centre - target) / np.linalg.norm(cameras[n].centre - target) for n in names}
    apart = [(a, b) for a, b in itertools.combinations(names, 2) if 40 < np.degrees(np.arccos(towards[a] @ towards[b])) < 120]
    return [apart[i] for i in rng.permutation(len(apart))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--pairs", type=int, default=10, help="that tags give; others are counted and left out")
    options = parser.parse_args()
    truth = json.loads((options.capture / "truth.json").read_text())
    true = {name: Camera(**camera) for name, camera in truth["cameras"].items()}
    by_colmap = {view.name: view.camera for view in load_views(options.capture)}
    layout, via = TagLayout.load(options.capture / "tags.json"), np.array(truth["world"]["motion"]["via"])
    rows, refused = [], 0
    for a, b in pairs(true, np.array(truth["world"]["view"]["target"]), via, np.random.default_rng(0)):
        with tempfile.TemporaryDirectory() as folder:
            try:
                posed = resect([options.capture / "photos" / f"{n}.png" for n in (a, b)], layout, folder)
            except ValueError:
                refused += 1
                continue
            f = posed.lenses[0]["params"][0]
        K = np.array([[f, 0, 320], [0, f, 240], [0, 0, 1]])
        by_tags = {n: Camera(K, pose, 640, 480) for n, pose in zip((a, b), posed.poses)}
        off = [1000 * np.linalg.norm(by_tags[n].centre - true[n].centre) for n in (a, b)]
        rng = np.random.default_rng(len(rows))
        drawn = {n: scripted.sketch(n, true[n], via, Hand(), rng, count=3) for n in (a, b)}
        intended = np.mean([drawn[n][1].mean(0) for n in (a, b)], axis=0)
        errors = []
        for cameras in (true, by_colmap, by_tags):
            sketches = [Sketch(n, cameras[n], drawn[n][0].strokes) for n in (a, b)]
            mean = rptl.fit(sketches, seed=0).distribution.mean_at(T)
            errors.append(1000 * np.median(np.linalg.norm(mean[:, None] - intended, axis=-1).min(1)))
        rows.append([max(off), posed.frame["uncertainty_mm"], *errors])
        print(f"| {a}, {b} | " + " | ".join(f"{x:.1f}" for x in rows[-1]) + " |", flush=True)
        if len(rows) == options.pairs:
            break
    print(f"{refused} pairs refused; median: " + " | ".join(f"{x:.1f}" for x in np.median(rows, axis=0)))
    print("columns: worse camera off [mm], as told [mm], motion off with true, COLMAP's, tags' cameras [mm]")


if __name__ == "__main__":
    main()
