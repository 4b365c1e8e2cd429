"""How often the taught motion can be planned, in the worlds as they stand: scripted sketches on the worlds' own views.

    python tests/benchmarks/planning.py                              # the table, its world under 20 seeds
    python tests/benchmarks/planning.py table --seeds 5 --samples 50 robot.planner.margin=0.02    # Hydra's overrides

    python tests/benchmarks/planning.py --ball 0.03 robot.planner.moved=0    # a ball set on the middle of the mean; moving off

No photographs: the user draws on the true cameras, learning is the default. "meant": whether the intended path itself can
be performed, by the planner's own means (all profiles, margin and sweep). Seconds are of CPU, of planning alone.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_module
from hydra.utils import instantiate

from robot.arm import Arm
from robot.attempt import Search
from robot.bullet import pybullet
from robot.collision import CollisionModel
from robot.world import World
from robot.variation import pre_grasp
from scene.camera import Camera, look_at
from teach.hand import Hand
from teach.rptl import fit
from teach.scripted import sketch, smooth_path
from teach.trajectory import Skill


def taught(spec: dict, seed: int, kept: Path | None) -> Skill:
    """The skill that the scripted user's strokes on two views give; kept in a folder where one is given."""
    file = None if kept is None else kept / f"{spec['name']}_{spec['seed']}_{seed}.npz"
    if file and file.exists():
        return Skill.load(file)
    rng, drawn = np.random.default_rng([seed, spec["seed"]]), []
    for number, view in enumerate(spec["sketch_views"][:2]):
        camera = Camera.from_fov(look_at(view["eye"], view["target"]), 640, 480, view["fov_deg"])
        drawn.append(sketch(f"view{number}", camera, spec["motion"]["via"], Hand(), rng)[0])
    skill = fit(drawn, seed=seed)
    if file:
        skill.save(file)
    return skill


def meant(spec: dict, arm, world, margin: float) -> str:
    """Empty where the intended path is feasible, else why not."""
    points = smooth_path(spec["motion"]["via"], 100)
    points[0] = arm.fk(arm.home)[:3, 3]
    search = Search(arm, CollisionModel(arm, world), arm.home, margin, 0.03, 24)
    return search.all(points[None])[0].refusal


def put_ball(world, at, radius: float) -> None:
    shape = world.client.createCollisionShape(pybullet.GEOM_SPHERE, radius=radius)
    world.bodies["ball"] = world.client.createMultiBody(0, shape, -1, at)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world", nargs="?", default="table")
    parser.add_argument("overrides", nargs="*", help="settings of robot.planner")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--ball", type=float, default=0.0, help="radius [m] of a ball that is set on the middle of the mean")
    parser.add_argument("--skills", type=Path, help="folder that keeps what was learned")
    options = parser.parse_args()
    with initialize_config_module("conf", version_base="1.3"):
        cfg = compose("config", overrides=[f"world={options.world}", *options.overrides])
    planner, arm, counts, refusals = instantiate(cfg.robot.planner, _convert_="all"), Arm.load("panda"), Counter(), Counter()
    print("seed  meant  feasible  end mm  seconds  what came of it")
    for seed in range(options.first, options.first + options.seeds):
        with World.load(options.world, seed=seed, textured=False) as world:
            skill = taught(world.spec, 0, options.skills)
            if options.ball:
                put_ball(world, skill.starting_at(arm.fk(arm.home)[:3, 3])[0].distribution.mean_at([0.5])[0], options.ball)
            wrong = meant(world.spec, arm, world, cfg.robot.planner.margin)
            started = time.process_time()
            plan = planner(skill, arm, world, start=arm.home, seed=0, samples=options.samples)
            seconds = time.process_time() - started
            off = 1e3 * np.linalg.norm(plan.tip[-1] - pre_grasp(world.spec))
        counts[(not wrong, plan.feasible)] += 1
        refusals.update(_reason(refusal) for refusal in plan.refusals)
        print(f"{seed:4d}  {'no ' if wrong else 'yes'}    {'yes' if plan.feasible else 'no '}     {off:6.1f} {seconds:8.1f}  {plan.sentence}"
              + (f"  [meant: {wrong}]" if wrong else ""), flush=True)  # fmt: skip
    print(f"feasible: {counts[True, True]} of {counts[True, True] + counts[True, False]} whose intended path is, "
          f"{counts[False, True]} of {counts[False, True] + counts[False, False]} others")  # fmt: skip
    for reason, count in refusals.most_common():
        print(f"{count:5d} refusals: {reason}")


def _reason(refusal: str) -> str:
    """A refusal without its numbers and names of samples."""
    for word, reason in (("reach", "out of reach"), ("jump", "no continuous posture"), ("off the path", "timing leaves the path"), ("sharply", "no timing")):
        if word in refusal:
            return reason
    return refusal.split(" of ")[-1].split(" into ")[-1].split(" (")[0]


if __name__ == "__main__":
    main()
