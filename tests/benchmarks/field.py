"""How good the field is after so many seconds of training: PSNR of photographs that training never saw.

    python tests/benchmarks/field.py data/table
    python tests/benchmarks/field.py data/banana --width 376 --seconds 30 60 150 --seeds 3
    python tests/benchmarks/field.py data/table --rival --picture docs/field.jpg     # beside a hash grid in stock torch; curve and held-out views
    python tests/benchmarks/field.py data/table --seconds 60 --darkest 0.4      # the training pictures exposed and balanced at random

The clock runs from the call of `scene.fit.fit` with decoded pictures and poses to its return; the kernels are compiled before.
Of pictures that are exposed at random, what the field shows is brightened by their mean before it is compared.
"""

import argparse
import resource
import time
from dataclasses import replace

import cv2
import numpy as np
from hashgrid import Rival

from conf.scene_stages import split
from scene.dataset import load_points, load_views
from scene.field.volume import psnr
from scene.fit import fit

EVERY = 4
"""Of the rival's views, one row and column in so many is shown: it takes minutes for a whole one."""


def scaled(view, width):
    height = round(view.camera.height * width / view.camera.width)
    image = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA)
    return type(view)(view.name, view.camera.resized(width, height), image)


def exposed_at_random(views, darkest: float):
    """The pictures, each from ``darkest`` to 1 times as bright and with white balances 5 % apart, and their geometric mean gain (3,)."""
    rng = np.random.default_rng(1)
    gains = np.exp(rng.uniform(np.log(darkest), 0, (len(views), 1)) + rng.normal(0, 0.05, (len(views), 3))).clip(max=1)
    shown = [replace(view, image=np.round(view.image * gain).astype(np.uint8)) for view, gain in zip(views, gains)]
    return shown, np.exp(np.log(gains).mean(0))


def measured(training, held_out, points, seconds: float, seed: int, gain):
    """A field's mean PSNR [dB], the steps it took, seconds for a view, and the views."""
    steps = []
    field = fit(training, points=points, seconds=seconds, seed=seed, progress=False, callback=lambda field, step, elapsed: steps.append(step))
    started = time.perf_counter()
    rendered = [field.render(view.camera)[0] for view in held_out]
    view_seconds = (time.perf_counter() - started) / len(held_out)
    rendered = [np.round(image / gain).clip(0, 255).astype(np.uint8) for image in rendered]
    return np.mean([psnr(image, view.image) for image, view in zip(rendered, held_out)]), max(steps), view_seconds, rendered


def rivals(training, held_out, points, seconds: float) -> tuple[float, int]:
    """The hash grid's mean PSNR [dB] and steps."""
    rival = Rival(training, points)
    steps = rival.fit(seconds)
    return np.mean([psnr(rival.render(view.camera, EVERY), view.image[::EVERY, ::EVERY]) for view in held_out]), steps


def picture(path, seconds, ours, theirs, held_out, rendered) -> None:
    """PSNR over seconds, and held-out photographs beside the field's views of them: the median one and the poorest."""
    from matplotlib.figure import Figure

    by_psnr = sorted(range(len(held_out)), key=lambda k: psnr(rendered[k], held_out[k].image))
    figure = Figure(figsize=(13, 6), layout="constrained")
    curve, *panels = figure.subplot_mosaic("cad;cbe", width_ratios=[0.9, 1, 1]).values()
    curve.plot(seconds, ours, "o-", label="this field")
    if theirs:
        curve.plot(seconds, theirs, "s--", color="grey", label="hash grid, stock torch")
    curve.set(xlabel="seconds of training", ylabel="PSNR of held-out photographs [dB]", xscale="log", xticks=seconds, xticklabels=[f"{s:g}" for s in seconds])
    curve.minorticks_off()
    curve.grid(alpha=0.3)
    curve.legend()
    for k, (left, right) in zip((by_psnr[len(by_psnr) // 2], by_psnr[0]), (panels[:2], panels[2:])):
        left.imshow(held_out[k].image), left.set_title(f"photograph {held_out[k].name}, held out")
        right.imshow(rendered[k]), right.set_title(f"the field, {psnr(rendered[k], held_out[k].image):.1f} dB")
    for panel in panels:
        panel.set_axis_off()
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", help="a folder that scene.reconstruct has written")
    parser.add_argument("--width", type=int, help="pictures are scaled to this width first")
    parser.add_argument("--seconds", type=float, nargs="+", default=[30, 60, 150])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--darkest", type=float, help="expose the training pictures at random, from so much of the brightest on")
    parser.add_argument("--rival", action="store_true", help="a hash grid in stock torch for as many seconds, too")
    parser.add_argument("--picture", help="a file for the curve and held-out views")
    options = parser.parse_args()

    views = load_views(options.capture)
    if options.width:
        views = [scaled(view, options.width) for view in views]
    points, _ = load_points(options.capture)
    training, held_out = split(views)
    training, gain = exposed_at_random(training, options.darkest) if options.darkest else (training, np.ones(3))
    fit(training, points=points, steps=2, progress=False).render(held_out[0].camera)
    print(f"{len(training)} pictures of {views[0].camera.width}x{views[0].camera.height}, {len(held_out)} held out")
    print(f"| seconds | PSNR [dB], each seed | mean | steps | a view [s] |{' hash grid [dB] | its steps |' * options.rival}\n|{'---|' * (5 + 2 * options.rival)}")
    ours, theirs = [], []
    for seconds in options.seconds:
        values, steps, view_seconds, rendered = zip(*(measured(training, held_out, points, seconds, seed, gain) for seed in range(options.seeds)))
        ours.append(np.mean(values))
        row = f"| {seconds:g} | {', '.join(f'{value:.2f}' for value in values)} | {ours[-1]:.2f} | {max(steps)} | {np.mean(view_seconds):.2f} |"
        if options.rival:
            mean, count = rivals(training, held_out, points, seconds)
            theirs.append(mean)
            row += f" {mean:.2f} | {count} |"
        print(row, flush=True)
    print(f"largest memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")
    if options.picture:
        picture(options.picture, options.seconds, ours, theirs, held_out, rendered[0])


if __name__ == "__main__":
    main()
