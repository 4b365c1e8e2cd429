"""Worlds under their seeds: is the intended motion feasible, and what becomes of sketches of it?

    python tests/benchmarks/worlds.py intended push_box tip_box --seeds 10        the true path itself, planned and performed
    python tests/benchmarks/worlds.py sketched table box shelf --seeds 20          the scripted user's sketches of it

The scene is known from truth: sketches are drawn on the world's own views, whose cameras are exact. Seed k is the k-th
variation of the world (world.seed = k), the k-th hand and the k-th plan; seed 0 is the world as published.
Columns: feasible: share of the seeds whose intended path can be planned. Of those, planned: the sketched motion can; done:
it is performed and meets all of the world's conditions. hand: distance [mm] from the goal, median and largest. tracking:
distance of the hand from the plan [mm, RMS], and pressed: force on what is to be touched [N], the largest of all seeds.
"""

import argparse
import time

import numpy as np

from robot import worldfile
from robot.arm import Arm
from robot.events import planned_events
from robot.execution import perform
from robot.mounting import mounted
from robot.planner import plan
from robot.world import World
from scene.camera import Camera, look_at
from teach import rptl
from teach.basis import SquaredExponential
from teach.hand import Hand
from teach.scripted import sketch, smooth_path
from teach.sketch import Event
from teach.trajectory import Skill, TrajectoryDistribution

SPREAD = 1e-8  # m^2 of the weights of a skill that is the intended path


def intended(spec: dict) -> Skill:
    """The path that is meant, as a skill without doubt."""
    t = np.linspace(0, 1, 200)
    basis = SquaredExponential(40, 250.0)
    weights = np.linalg.lstsq(basis(t), smooth_path(spec["motion"]["via"]), rcond=1e-10)[0]
    events = tuple(Event(name, 3.0 * share) for name, share in spec["motion"].get("events", []))
    return Skill(TrajectoryDistribution(basis, weights, SPREAD * np.eye(120)), 3.0, events)


def sketched(spec: dict, seed: int) -> Skill:
    """What RPTL learns from three strokes on each of the world's first two views."""
    rng, sketches = np.random.default_rng(seed), []
    for k, view in enumerate(spec["sketch_views"][:2]):
        camera = Camera.from_fov(look_at(view["eye"], view["target"]), 640, 480, view["fov_deg"])
        events = spec["motion"].get("events", [])
        sketches.append(sketch(f"view{k + 1}", camera, spec["motion"]["via"], Hand(), rng, events=events)[0])
    return rptl.fit(sketches, seed=seed)


def tried(name: str, seed: int, arm: Arm, skill_of, **settings) -> tuple[object, object]:
    """(Plan, Execution or None where there is no feasible plan)."""
    spec, arm = mounted(worldfile.read(name) | {"seed": seed}, arm)
    with World.from_spec(spec, textured=False) as world:
        world.spec["motion"]["via"][0] = arm.fk(arm.home)[:3, 3].tolist()  # whichever arm it is, its hand begins
        skill = skill_of(world.spec)
        settings |= {"orientation": world.spec["motion"].get("orientation")}
        with World.from_spec(spec, textured=False) as known:
            known.bring_held(arm, arm.home)
            chosen = plan(skill, arm, known.obstacles, seed=seed, **settings)
        return chosen, perform(chosen, arm, world, events=planned_events(skill, chosen), fps=0) if chosen.feasible else None


def row(name: str, seeds: range, arm: Arm, kind: str) -> str:
    feasible, planned, done, performances = [], [], [], []
    for seed in seeds:
        started = time.process_time()
        chosen, performed = tried(name, seed, arm, intended, samples=1)
        feasible.append(chosen.feasible)
        if kind == "sketched" and chosen.feasible:
            chosen, performed = tried(name, seed, arm, lambda spec: sketched(spec, seed))
        if feasible[-1]:
            planned.append(chosen.feasible)
            done.append(performed is not None and performed.success)
        if performed is not None:
            performances.append(performed)
        said = performed.sentence if performed is not None else chosen.sentence
        print(f"  {name} {seed} ({time.process_time() - started:.0f} s): {said}", flush=True)
    hand = [1e3 * performed.final_error for performed in performances]
    numbers = [f"{np.median(hand):.0f} / {max(hand):.0f}", f"{max(p.metrics['tracking_error_mm'] for p in performances):.1f}",
               f"{max(p.press for p in performances):.0f}"] if hand else ["-"] * 3  # fmt: skip
    return f"| {name} | {sum(feasible)} of {len(feasible)} | {sum(planned)} of {len(planned)} | {sum(done)} of {len(done)} | {' | '.join(numbers)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("intended", "sketched"))
    parser.add_argument("worlds", nargs="+")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first of them")
    parser.add_argument("--arm", default="panda")
    options = parser.parse_args()
    arm = Arm.load(options.arm)
    rows = [row(name, range(options.first, options.first + options.seeds), arm, options.kind) for name in options.worlds]
    print("| world | feasible | planned | done | hand, mm: median / most | tracking, mm: most | pressed, N: most |\n|---|---|---|---|---|---|---|", *rows, sep="\n")


if __name__ == "__main__":
    main()
