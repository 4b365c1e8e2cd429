"""What each improvement over the paper brings: the steps of conf/experiment/ablation, one row each.

    python tests/benchmarks/ablation.py letters ../shared/data/strokes --seeds 2     # letters drawn by a person
    python tests/benchmarks/ablation.py scripted --seeds 30 --modes own              # random motions, cameras and hands
    python tests/benchmarks/ablation.py letters DIR --steps 00_paper 09_default teach/density=joint_flow_authors

A row is the mean over all motions and seeds; columns are those of strokes.py. Hydra's overrides hold for every step.
The same steps through the whole job, on the simulated scene: scene2skill -m experiment=ablation.
"""

from pathlib import Path

from strokes import cases, fitter, heading, line, mean_scores, parsed, parser

import conf

STEPS = sorted(path.stem for path in (Path(conf.__file__).parent / "experiment/ablation").glob("*.yaml"))
WIDTH = max(map(len, STEPS)) + 2


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--steps", nargs="+", default=STEPS, choices=STEPS)
    args, overrides, folders = parsed(options)
    for mode in args.modes:
        print(heading(mode, WIDTH), flush=True)
        for step in args.steps:
            fit = fitter([f"experiment=ablation/{step}", *overrides])
            each = cases(args.protocol, mode, args.seeds, *folders)
            print("\r" + line(step, mean_scores(fit, each), WIDTH), flush=True)


if __name__ == "__main__":
    main()
