"""How good the field is after so many seconds of training: PSNR of photographs that training never saw.

    python tests/benchmarks/field.py data/table
    python tests/benchmarks/field.py data/banana --width 376 --seconds 30 60 150 --seeds 3

The clock runs from the call of `scene.fit.fit` with decoded pictures and poses to its return; the kernels are compiled before.
"""

import argparse
import resource
import time

import cv2
import numpy as np

from conf.scene_stages import split
from scene.dataset import load_points, load_views
from scene.field.volume import psnr
from scene.fit import fit


def scaled(view, width):
    height = round(view.camera.height * width / view.camera.width)
    image = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA)
    return type(view)(view.name, view.camera.resized(width, height), image)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", help="a folder that scene.reconstruct has written")
    parser.add_argument("--width", type=int, help="pictures are scaled to this width first")
    parser.add_argument("--seconds", type=float, nargs="+", default=[30, 60, 150])
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()

    views = load_views(options.capture)
    if options.width:
        views = [scaled(view, options.width) for view in views]
    points, _ = load_points(options.capture)
    training, held_out = split(views)
    fit(training, points=points, steps=2, progress=False).render(held_out[0].camera)
    print(f"{len(training)} pictures of {views[0].camera.width}x{views[0].camera.height}, {len(held_out)} held out")
    print("| seconds | PSNR [dB], each seed | mean | steps | a view [s] |\n|---|---|---|---|---|")
    for seconds in options.seconds:
        values, steps = [], []
        for seed in range(options.seeds):

            def count(field, step, elapsed, steps=steps):
                steps.append(step)

            field = fit(training, points=points, seconds=seconds, seed=seed, progress=False, callback=count)
            started = time.perf_counter()
            rendered = [field.render(view.camera)[0] for view in held_out]
            view_seconds = (time.perf_counter() - started) / len(held_out)
            values.append(np.mean([psnr(image, view.image) for image, view in zip(rendered, held_out)]))
        each = ", ".join(f"{value:.2f}" for value in values)
        print(f"| {seconds:g} | {each} | {np.mean(values):.2f} | {max(steps)} | {view_seconds:.2f} |", flush=True)
    print(f"largest memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")


if __name__ == "__main__":
    main()
