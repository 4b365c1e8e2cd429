"""Cameras for Table I: such that the straight line and the nearest view are as wrong as in the paper, as far apart as they then can be.

    python tests/benchmarks/hardness.py table box shelf          # what conf/experiment/table1/*.yaml has
    python tests/benchmarks/hardness.py box --draws 3000

The paper tells neither cameras nor motions, but how wrong these two baselines are. Three cameras are drawn at random on a sphere about
the motion, where the world is photographed from; those that hold the whole motion, with a margin, and make both baselines as wrong as
the paper's within a factor of 1.2 are kept, farthest apart first. The motion is the intended one, without a hand: no method is run.
"""

import argparse
from itertools import combinations

import numpy as np
from hydra import compose, initialize_config_module

from scene.views import given
from teach import baselines, metrics, scripted
from teach.curve import resample

PAPER = {"table": (10.6, 17.8), "box": (7.4, 33.2), "shelf": (9.7, 7.9)}  # straight line, nearest view: MFD, % of the width
FROM = {  # azimuth [deg], elevation [deg], radius [m]
    "table": ((100, 260), (25, 65), (1.25, 1.75)),
    "box": ((105, 255), (35, 72), (1.3, 1.65)),
    "shelf": ((125, 235), (5, 38), (1.3, 1.6)),
}
ALIKE, LEAST, POINTS = 1.2, 25.0, 60


def drawn(world: str, centre, rng) -> tuple[list[dict], float]:
    """Three {eye, target, fov_deg}, and the smallest angle [deg] between two of them."""
    azimuths, elevations, radii = FROM[world]
    azimuth, elevation = np.radians(np.stack([rng.uniform(*azimuths, 3), rng.uniform(*elevations, 3)]))
    towards = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1)
    radius, fov = rng.uniform(*radii), int(rng.choice([45, 50, 55, 60]))
    apart = min(np.degrees(np.arccos(towards[i] @ towards[j])) for i, j in combinations(range(3), 2))
    return [{"eye": eye, "target": centre, "fov_deg": fov} for eye in centre + radius * towards], apart


def wrong(cameras, path) -> tuple[float, float] | None:
    """MFD [% of the width] of both baselines, mean over the three held-out views; None where a picture does not hold the motion."""
    pixels = [camera.project(path) for camera in cameras]
    if any((p < [64, 48]).any() or (p > [576, 432]).any() for p in pixels):
        return None
    pixels, rows = [resample(p, POINTS) for p in pixels], []
    for held_out, camera in enumerate(cameras):
        others = [i for i in range(3) if i != held_out]
        nearest = min(others, key=lambda i: baselines.pose_distance(cameras[i], camera))
        line = resample(baselines.linear([pixels[held_out]]), POINTS)
        rows.append([metrics.frechet(curve, pixels[held_out]) / 6.4 for curve in (line, pixels[nearest])])
    return tuple(np.mean(rows, axis=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", nargs="+", choices=PAPER)
    parser.add_argument("--draws", type=int, default=1500)
    options = parser.parse_args()
    for world in options.worlds:
        with initialize_config_module("conf", version_base=None):
            via = compose("config", overrides=["experiment=table1", f"+experiment/table1={world}"]).world.motion.via
        path = scripted.smooth_path(via)
        centre, rng, found = (path.min(0) + path.max(0)) / 2, np.random.default_rng(1), []
        for _ in range(options.draws):
            views, apart = drawn(world, centre, rng)
            both = wrong(given(views), path) if apart >= LEAST else None
            if both and max(abs(np.log(np.divide(both, PAPER[world])))) < np.log(ALIKE):
                found.append((apart, both, views))
        print(f"{world}: {len(found)} of {options.draws}; the paper's {PAPER[world]}")
        for apart, both, views in sorted(found, key=lambda one: -one[0])[:3]:
            eyes = ", ".join(str(np.round(view["eye"], 2).tolist()) for view in views)
            print(f"  {apart:.0f} degrees apart, {both[0]:.1f} and {both[1]:.1f} %, fov {views[0]['fov_deg']}, eyes {eyes}")


if __name__ == "__main__":
    main()
