"""Motions whose end was snapped to a surface: how near to that point does the hand come?

    python tests/benchmarks/snapped.py --seeds 10                    # free: as the planner turns the hand; down: fingers first

The table's world, obstacles and depth pictures from truth; the scripted user draws a motion that ends on the table's top, and
marks a contact there. snapped: from the point that the sketch's end was snapped to, to the nearest point of the hand's shapes
where Bullet has them at the end; end: to the middle of its fingers' ends; meant: from the point that was meant to that.
touched: performances that touched anything (a hand stops 1.5 mm before what it is to touch).
"""

import argparse

import numpy as np

from robot import worldfile
from robot.arm import Arm
from robot.execution import perform
from robot.planner import plan
from robot.world import World
from scene.camera import Camera, look_at
from teach import rptl
from teach.hand import Hand
from teach.scripted import sketch

VIA = [[0.45, -0.15, 0.50], [0.58, -0.30, 0.42], [0.62, -0.36, 0.32], [0.62, -0.37, 0.2205]]


def taught(world, seed: int):
    rng, drawn, depths = np.random.default_rng(seed), [], {}
    for k, view in enumerate(world.spec["sketch_views"][:2]):
        camera = Camera.from_fov(look_at(view["eye"], view["target"]), 640, 480, view["fov_deg"])
        drawn.append(sketch(f"view{k}", camera, world.spec["motion"]["via"], Hand(), rng, events=[["contact", 1.0]])[0])
        depths[f"view{k}"] = world.photograph_with_depth(camera)[1]
    return rptl.fit(drawn, seed=seed, depths=depths)


def tried(seed: int, arm: Arm, orientation) -> tuple[float, float, float, bool] | None:
    """Distances [m], see above, and whether it touched anything."""
    spec = worldfile.read("table") | {"seed": seed}
    spec["motion"]["via"][1:] = VIA
    spec.pop("goal")
    with World.from_spec(spec) as world:
        skill = taught(world, seed)
        chosen = plan(skill, arm, world.obstacles, seed=seed, orientation=orientation)
        print(f"  {seed}: {chosen.sentence}", flush=True)
        if not chosen.feasible:
            return None
        done, end = perform(chosen, arm, world, fps=0), skill.distribution.mean_at([1.0])[0]
        off = (np.linalg.norm(done.tip[-1] - place) for place in (end, world.spec["motion"]["via"][-1]))
        return done.touch_error, *off, bool(done.touched)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    options, arm, rows = parser.parse_args(), Arm.load("panda"), []
    for orientation in ("free", "down"):
        tries = [tried(seed, arm, orientation) for seed in range(options.seeds)]
        snapped, end, meant, touched = (np.array(column) for column in zip(*(one for one in tries if one)))
        columns = " | ".join(f"{1e3 * np.median(off):.1f} / {1e3 * off.max():.1f}" for off in (snapped, end, meant))
        rows.append(f"| {orientation} | {len(snapped)} of {len(tries)} | {columns} | {touched.sum()} |")
    print("| hand | feasible | snapped, mm: median / most | end, mm | meant, mm | touched |\n|---|---|---|---|---|---|", *rows, sep="\n")


if __name__ == "__main__":
    main()
