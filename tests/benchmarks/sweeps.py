"""What a sweep costs beside its stages, whether two jobs at once are worth it, and whether killed and other launchers' sweeps find the same.

    python tests/benchmarks/sweeps.py                          # 40 jobs over teach.* one by one, and two at once: 4 minutes on two free cores
    python tests/benchmarks/sweeps.py overhead --jobs 20 stages=[render,sketch,fit]     # Hydra's overrides; here without each job's report
    python tests/benchmarks/sweeps.py killed                   # SIGKILL at half of the jobs, resumed: against a sweep that was let alone
    python tests/benchmarks/sweeps.py launchers                # joblib, submitit_local, ray (those that are installed) against basic

The scene is the tiny world, known from truth. Every process has one thread. Seconds are wall time, so that the machine should be free.
"""

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

from conf.rerun import TIMES

SCENE = ["world=tiny", "scene.truth=true", "stages=[render,sketch,fit,report]"]
EIGHT = ["teach.basis.count=16,20", "seed=range(4)"]
LAUNCHERS = {"joblib": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"], "submitit": ["hydra/launcher=submitit_local"],
             "ray": ["hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2"]}  # fmt: skip
ENVIRONMENT = os.environ | {f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA")} | {"PYTHONPATH": str(Path(__file__).parents[2])}


def start(cwd: Path, name: str, overrides) -> subprocess.Popen:
    """A sweep in runs/<name> of ``cwd``; what it says goes into <name>.log."""
    command = [sys.executable, "-m", "conf.pipeline", "-m", *SCENE, *overrides, f"hydra.sweep.dir=runs/{name}"]
    with (cwd / f"{name}.log").open("a") as log:
        return subprocess.Popen(command, cwd=cwd, env=ENVIRONMENT, stdout=log, stderr=subprocess.STDOUT, start_new_session=True)


def swept(cwd: Path, name: str, overrides) -> float:
    """Run a sweep to its end; its seconds."""
    started = time.perf_counter()
    process = start(cwd, name, overrides)
    try:
        failed = process.wait()
    except BaseException:  # stopped by hand: a process group of its own hears nothing of it
        os.killpg(process.pid, signal.SIGKILL)
        raise
    if failed:
        raise SystemExit((cwd / f"{name}.log").read_text()[-2000:])
    return time.perf_counter() - started


def jobs(cwd: Path, name: str) -> list[tuple[dict, dict]]:
    """status.json and metrics.json of each job."""
    folders = sorted((path.parent for path in (cwd / "runs" / name).glob("*/metrics.json")), key=lambda folder: int(folder.name))
    return [tuple(json.loads((folder / file).read_text()) for file in ("status.json", "metrics.json")) for folder in folders]


def figures(cwd: Path, name: str) -> list[dict]:
    """The lines of results.csv without what no two runs share: times, memory."""
    with (cwd / "runs" / name / "results.csv").open() as file:
        lines = list(csv.DictReader(file))
    return [{key: value for key, value in line.items() if key != "job" and key.rpartition(".")[2] not in TIMES} for line in lines]


def overhead(cwd: Path, overrides, count: int, lanes) -> None:
    """Per job: its own stages, the rest of the job (report, figures), and what lies between jobs (Hydra, imports, the table)."""
    over = [f"teach.basis.count=range(10,{10 + count // 2})", "teach.density.hidden=32,48"]
    print(f"{f'{count // 2 * 2} jobs':14}{'whole, s':>10}{'stages':>9}{'report':>9}{'between':>9}{'overhead':>10}{'scene built':>13}")
    walls = {}
    for lane in lanes:
        name, launcher = {1: ("one by one", []), 2: ("two at once", LAUNCHERS["joblib"])}[lane]
        walls[lane] = wall = swept(cwd, f"lane{lane}", [*overrides, *over, f"data=scene{lane}", *launcher])
        done = jobs(cwd, f"lane{lane}")
        own = [sum(metrics[stage]["seconds"] for stage in ("sketch", "teach")) for _, metrics in done]
        scenes = {metrics["render"]["seconds"] for _, metrics in done}
        inside = sum(status["seconds"] for status, _ in done) - sum(scenes)
        each = [wall, sum(own) / len(done), (inside - sum(own)) / len(done), (lane * wall - inside - sum(scenes)) / len(done)]
        print(f"{name:14}{each[0]:10.1f}{each[1]:9.2f}{each[2]:9.2f}{each[3]:9.2f}{each[2] + each[3]:10.2f}{len(scenes):12d} x", flush=True)
    if len(walls) > 1:
        print(f"two at once take {walls[2] / walls[1]:.2f} x the time of one by one")


def killed(cwd: Path, overrides) -> None:
    """A sweep that gets SIGKILL when half of its jobs are done, in the middle of the next; the same command again."""
    swept(cwd, "alone", [*overrides, *EIGHT])
    process = start(cwd, "killed", [*overrides, *EIGHT])
    while sum(status["state"] == "finished" for status, _ in jobs(cwd, "killed")) < 4:
        time.sleep(0.05)
    time.sleep(1.5)  # the fifth is under way
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = {i: status for i, (status, _) in enumerate(jobs(cwd, "killed")) if status["state"] == "finished"}
    swept(cwd, "killed", [*overrides, *EIGHT])
    after = [status for status, _ in jobs(cwd, "killed")]
    again = sum(after[i] != status for i, status in before.items())
    print(f"killed with {len(before)} of 8 jobs done; after the same command: {sum(s['state'] == 'finished' for s in after)} of 8 done, {again} done twice, "
          f"figures {'equal' if figures(cwd, 'killed') == figures(cwd, 'alone') else 'DIFFERENT'}")  # fmt: skip


def launchers(cwd: Path, overrides) -> None:
    """Figures of each launcher's sweep against the basic one's, bit for bit."""
    print(f"basic: {swept(cwd, 'basic', [*overrides, *EIGHT]):.0f} s")
    for name, options in LAUNCHERS.items():
        if find_spec(f"hydra_plugins.hydra_{name}_launcher") is None:
            print(f"{name}: not installed")
            continue
        seconds = swept(cwd, name, [*overrides, *EIGHT, *options])
        print(f"{name}: {seconds:.0f} s, figures {'equal' if figures(cwd, name) == figures(cwd, 'basic') else 'DIFFERENT'}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", default="overhead", choices=["overhead", "killed", "launchers"])
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("overrides", nargs="*")
    args = parser.parse_intermixed_args()
    with tempfile.TemporaryDirectory() as folder:
        if args.what == "overhead":
            overhead(Path(folder), args.overrides, args.jobs, args.lanes)
        else:
            {"killed": killed, "launchers": launchers}[args.what](Path(folder), args.overrides)


if __name__ == "__main__":
    main()
