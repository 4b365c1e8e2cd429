"""Letters on the board: sketched once, written from starts at random.

    python tests/benchmarks/letters.py B Z U R --starts 10

The scene is known from truth; the scripted user draws three strokes on each of two views. written: plans that are feasible and
are performed without contact. right: of the 26 letters the nearest is the one that was meant. planned: Frechet distance [mm] of
the performed to the planned path, the largest; intended: of the performed to the intended letter, median; oracle: of the mean
of the paths behind the strokes to the intended letter; mean: of the learned mean, begun where it was taught.
"""

import argparse
import time

import numpy as np

from conf.writing import written
from robot import worldfile
from robot.arm import Arm
from robot.execution import perform
from robot.planner import plan
from robot.world import World
from scene.camera import Camera, look_at
from teach import rptl
from teach.hand import Hand
from teach.scripted import sketch


def taught(motion, views, seed):
    """The skill, and the paths (S, T, 3) behind the strokes."""
    rng, sketches, paths = np.random.default_rng(seed), [], []
    for k, view in enumerate(views[:2]):
        camera = Camera.from_fov(look_at(view["eye"], view["target"]), 640, 480, view["fov_deg"])
        drawn, meant = sketch(f"view{k + 1}", camera, motion["via"], Hand(), rng)
        sketches.append(drawn), paths.extend(meant)
    return rptl.fit(sketches, seed=seed), np.stack(paths)


def row(name: str, starts: int, arm: Arm, seed: int) -> str:
    spec = worldfile.read("board")
    spec["motion"]["letter"] = name
    spec["motion"]["via"][0] = arm.fk(arm.home)[:3, 3].tolist()
    with World.from_spec(spec, textured=False) as world:
        skill, meant = taught(world.spec["motion"], world.spec["sketch_views"], seed)
        mean = skill.distribution.mean_at(np.linspace(0, 1, 200))
        learned = written(world.spec["motion"], mean, mean, meant)
    rated = []
    for start in range(starts):
        began = time.process_time()
        with World.from_spec(spec, textured=False) as world:
            chosen = plan(skill, arm, world.obstacles, seed=start, starts_within=0.1)
            said = chosen.sentence
            if chosen.feasible:
                done = perform(chosen, arm, world, fps=0)
                said = done.sentence
                if done.success:
                    rated.append(written(world.spec["motion"], done.tip, chosen.tip, meant))
                    said = f"looks like {rated[-1]['looks_like']}, {rated[-1]['to_intended_mm']:.0f} mm from the intended one"
        print(f"  {name} {start} ({time.process_time() - began:.0f} s): {said}", flush=True)
    of = lambda key: [one[key] for one in rated] or [np.nan]
    return (f"| {name} | {len(rated)} of {starts} | {sum(one['right'] for one in rated)} of {starts} | {max(of('to_planned_mm')):.1f} "
            f"| {np.median(of('to_intended_mm')):.0f} | {learned['oracle_to_intended_mm']:.0f} | {learned['to_intended_mm']:.0f} |")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("letters", nargs="+")
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--arm", default="panda")
    parser.add_argument("--seed", type=int, default=0, help="of the sketches")
    options = parser.parse_args()
    rows = [row(name, options.starts, Arm.load(options.arm), options.seed) for name in options.letters]
    print("| letter | written | right | planned | intended | oracle | mean |\n|---|---|---|---|---|---|---|", *rows, sep="\n")


if __name__ == "__main__":
    main()
