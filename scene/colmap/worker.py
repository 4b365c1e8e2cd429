"""Starts the process that does COLMAP's work (scene.colmap.process) and listens to it."""

import json
import subprocess
import sys
from pathlib import Path

from tqdm import tqdm


def command(function: str) -> list[str]:
    """What calls a function of scene.colmap.process in a new interpreter that finds packages as this one does."""
    code = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from scene.colmap import process; process.{function}()"
    return [sys.executable, "-P", "-c", code, json.dumps([str(Path(__file__).parents[2]), *sys.path])]


def run(settings: dict, log: Path, progress: bool) -> dict:
    """Do the work in another process, which dies with this one; its last line is the answer, "done" or a "failure"."""
    with open(log, "wb") as errors:
        worker = subprocess.Popen(command("work"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        worker.stdin.write(json.dumps(settings) + "\n")
        worker.stdin.flush()  # and stays open: its end tells the worker that nobody waits any more
        answer = {}
        with tqdm(total=len(settings["names"]), unit="photo", disable=not progress, leave=False) as bar:
            for line in worker.stdout:
                answer = json.loads(line)
                _show(bar, answer)
        worker.wait()
    finally:
        worker.kill()
        worker.wait()
        worker.stdin.close()
        worker.stdout.close()
    if not answer.keys() & {"done", "failure"}:
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no message"]
        return {"failure": f"COLMAP's process ended with code {worker.returncode}: {last[0][-300:]}"}
    return answer


def _show(bar: tqdm, message: dict):
    if "stage" in message:
        bar.set_description(message["stage"])
        bar.n = 0
    bar.n = message.get("count", bar.n)
    bar.refresh()
