"""COLMAP's process: it does the work of scene.colmap, answers in lines of JSON, and dies with whoever asked."""

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from tqdm import tqdm


def run(settings: dict, log: Path, progress: bool) -> dict:
    """Do the work in another process, which dies with this one; its last line is the answer, "done" or a "failure"."""
    code = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from scene.colmap import _work; _work()"
    command = [sys.executable, "-P", "-c", code, json.dumps([str(Path(__file__).parents[1]), *sys.path])]
    with open(log, "wb") as errors:
        worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True)
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


def die_with_parent():
    """End when the other end of stdin is gone; on Linux by the kernel, as pycolmap holds the interpreter for long."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
