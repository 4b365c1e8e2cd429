"""A sweep goes on where it was stopped, names what failed, ends with its table; a job can be repeated and compared.

The jobs are real jobs of Hydra with a short task of the test's own in place of the whole job.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from conf.results import collect, markdown

TASK = """
import json, os, signal, sys, time
from pathlib import Path
from conf.run import launch
from conf.stages import write_json

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is born without it

def task(job):
    seed = job.cfg.seed
    with open("began.txt", "a") as file:
        file.write(f"{seed}\\n")
    if Path(f"kill{seed}").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    if Path(f"fail{seed}").exists():
        raise ValueError("the strokes of\\nseed are wrong")
    if Path(f"wait{seed}").exists():
        Path("waiting").touch()
        time.sleep(300)
    count = job.cfg.teach.basis.count
    noise = time.time() if Path("noisy").exists() else 0
    write_json(job.run / "metrics.json", {"teach": {"mfd": 0.02 + seed / 1000 + count / 10000 + noise, "oracle_mfd": 0.01, "seconds": time.time()}})
    write_json(job.run / "sketches.json", {"seed": seed})

sys.exit(launch(task))
"""


@pytest.fixture
def launch(tmp_path):
    (tmp_path / "job.py").write_text(TASK)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}

    def run(*arguments):
        return subprocess.run([sys.executable, "job.py", *arguments], capture_output=True, text=True, cwd=tmp_path, env=environment)

    return run


def sweeps(folder):
    return sorted(path.parent for path in folder.glob("runs/default/*/sweep.json"))


def began(folder):
    path = folder / "began.txt"
    return path.read_text().split() if path.exists() else []


def test_a_finished_sweep_has_its_table(launch, tmp_path):
    result = launch("-m", "seed=0,1,2,3,4", "teach.basis.count=10,20")
    assert result.returncode == 0, result.stderr
    (sweep,) = sweeps(tmp_path)
    table = (sweep / "table.md").read_text()
    assert "| 10 | 5 | 2.3 ± 0.16 |" in table and "10 of 10 jobs finished" in table
    assert "teach.basis.count=20 minus teach.basis.count=10: +0.1 over 5 pairs" in table
    assert len((sweep / "results.csv").read_text().splitlines()) == 11
    assert "<button>teach.basis.count" in (sweep / "report.html").read_text()
    assert not list(tmp_path.rglob(".*.tmp"))


def test_a_killed_sweep_goes_on_with_what_is_missing(launch, tmp_path):
    (tmp_path / "kill2").touch()
    assert launch("-m", "seed=0,1,2,3").returncode == -signal.SIGKILL
    assert began(tmp_path) == ["0", "1", "2"]
    (tmp_path / "kill2").unlink()
    result = launch("-m", "seed=0,1,2,3")
    assert result.returncode == 0 and "going on with" in result.stdout
    assert "was killed when it ran last" in result.stdout and began(tmp_path) == ["0", "1", "2", "2", "3"]
    (sweep,) = sweeps(tmp_path)
    assert "4 of 4 jobs finished" in (sweep / "table.md").read_text()
    launch("-m", "seed=0,1,2,3", "hydra.sweep.dir=runs/alone")
    assert (sweep / "table.md").read_text() == (tmp_path / "runs" / "alone" / "table.md").read_text()


def test_a_job_that_is_killed_whenever_it_runs_does_not_keep_those_behind_it_from_running(launch, tmp_path):
    (tmp_path / "kill1").touch()
    assert [launch("-m", "seed=0,1,2").returncode for _ in range(3)] == [-signal.SIGKILL, -signal.SIGKILL, 2]
    assert began(tmp_path) == ["0", "1", "1", "2"]
    (sweep,) = sweeps(tmp_path)
    assert "Missing: 1 (seed=1): failed, it was killed 2 times" in (sweep / "table.md").read_text()


def test_a_failed_job_lets_the_others_go_on_and_is_named(launch, tmp_path):
    (tmp_path / "fail1").touch()
    result = launch("-m", "seed=0,1,2")
    assert result.returncode == 2 and "Traceback" not in result.stderr + result.stdout
    (sweep,) = sweeps(tmp_path)
    status = json.loads((sweep / "1" / "status.json").read_text())
    assert status["state"] == "failed" and status["error"] == "the strokes of seed are wrong" and "Traceback" in status["traceback"]
    assert "Missing: 1 (seed=1): failed, the strokes of seed are wrong" in (sweep / "table.md").read_text()
    (tmp_path / "fail1").unlink()
    assert launch("-m", "seed=0,1,2").returncode == 0
    assert began(tmp_path) == ["0", "1", "2", "1"]
    launch("-m", "seed=0,1,2")
    assert began(tmp_path)[4:] == ["0", "1", "2"]  # a finished sweep begins anew


def test_a_finished_sweep_that_lost_a_job_runs_that_alone(launch, tmp_path):
    launch("-m", "seed=0,1,2")
    (sweep,) = sweeps(tmp_path)
    table = (sweep / "table.md").read_text()
    shutil.rmtree(sweep / "1")
    assert "going on with" in launch("-m", "seed=0,1,2").stdout
    assert began(tmp_path) == ["0", "1", "2", "1"] and sweeps(tmp_path) == [sweep] and (sweep / "table.md").read_text() == table


def test_failed_jobs_of_other_code_are_run_again_where_their_folder_is_named(launch, tmp_path):
    (tmp_path / "fail1").touch()
    assert "the same command does what is missing again" in launch("-m", "seed=0,1").stderr
    (tmp_path / "fail1").unlink()
    (sweep,) = sweeps(tmp_path)
    begun = json.loads((sweep / "sweep.json").read_text())
    (sweep / "sweep.json").write_text(json.dumps(begun | {"key": begun["key"] | {"git": "another"}}))
    assert f"of other code: hydra.sweep.dir={sweep.relative_to(tmp_path)} goes on with it" in launch("-m", "seed=0,1").stdout
    assert launch("-m", "seed=0,1", f"hydra.sweep.dir={sweep}").returncode == 0
    assert began(tmp_path) == ["0", "1", "0", "1", "1"] and "2 of 2 jobs finished" in (sweep / "table.md").read_text()


def test_a_command_line_that_is_wrong_leaves_no_folder(launch, tmp_path):
    assert launch("-m", "experiment=tabel1").returncode == 2 and not (tmp_path / "runs" / "tabel1").exists()


def test_the_table_of_a_killed_sweep_says_that_jobs_did_not_begin(launch, tmp_path):
    (tmp_path / "kill1").touch()
    launch("-m", "seed=0,1,2,3")
    (sweep,) = sweeps(tmp_path)
    assert f"{sweep.name} was stopped, or still runs" in markdown(collect([sweep]))


@pytest.mark.parametrize("there", ["sweep", "letter"])
def test_what_lies_in_the_chosen_folder_is_not_overwritten(launch, tmp_path, there):
    if there == "sweep":
        launch("-m", "seed=0,1", "hydra.sweep.dir=runs/mine")
    else:
        (tmp_path / "runs" / "mine").mkdir(parents=True)
        (tmp_path / "runs" / "mine" / "letter.txt").write_text("Dear")
    refused = launch("-m", "seed=5,6", "hydra.sweep.dir=runs/mine")
    said = "holds the sweep of seed=0,1" if there == "sweep" else "is no folder of a sweep and not empty"
    assert refused.returncode == 2 and said in refused.stderr and "Traceback" not in refused.stderr
    assert "5" not in began(tmp_path)


def test_jobs_that_failed_alike_are_named_in_one_line(launch, tmp_path):
    said = launch("-m", "seed=-1,abc,3", "teach.basis.count=10,20").stderr
    assert said.splitlines()[:-1] == [f"jobs {jobs} failed: seed={seed} is no seed: give a whole number from 0 on" for jobs, seed in (("0, 1", -1), ("2, 3", "abc"))]
    assert began(tmp_path) == ["3", "3"]


def test_one_job_of_an_experiment_says_that_there_are_more(launch):
    assert "experiment=letters sweeps over world.motion.letter, seed: this is one job of it" in launch("experiment=letters").stdout


def test_other_settings_or_another_folder_are_another_sweep(launch, tmp_path):
    (tmp_path / "fail1").touch()
    launch("-m", "seed=0,1")
    launch("-m", "seed=0,1", "teach.basis.count=10")
    assert len(sweeps(tmp_path)) == 2 and began(tmp_path) == ["0", "1", "0", "1"]
    launch("-m", "seed=0,1", "hydra.sweep.dir=runs/mine")
    assert (tmp_path / "runs" / "mine" / "table.md").exists()


def test_two_of_the_same_command_do_not_share_a_folder(launch, tmp_path):
    (tmp_path / "wait1").touch()
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    first = subprocess.Popen([sys.executable, "job.py", "-m", "seed=0,1"], cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)
    while not (tmp_path / "waiting").exists():
        assert first.poll() is None
    (tmp_path / "wait1").unlink()
    (sweep,) = sweeps(tmp_path)
    taken = launch("-m", "seed=0,1", f"hydra.sweep.dir={sweep}")
    assert taken.returncode == 2 and "a sweep runs in" in taken.stderr
    assert launch("-m", "seed=0,1").returncode == 0
    first.send_signal(signal.SIGINT)
    assert first.wait() == 130 and len(sweeps(tmp_path)) == 2
    assert json.loads((sweep / "sweep.json").read_text())["state"] == "stopped"


@pytest.mark.parametrize("launcher", ["joblib", pytest.param("submitit", marks=pytest.mark.slow), pytest.param("ray", marks=pytest.mark.slow)])
def test_a_launcher_has_the_basic_one_s_results_and_says_if_a_job_was_killed(launch, tmp_path, launcher):
    pytest.importorskip(f"hydra_plugins.hydra_{launcher}_launcher")
    options = {"joblib": ["joblib", "hydra.launcher.n_jobs=2"], "submitit": ["submitit_local"], "ray": ["ray", "+hydra.launcher.ray.init.num_cpus=2"]}
    first, *more = options[launcher]
    (tmp_path / "kill2").touch()
    killed = launch("-m", "seed=0,1,2", f"hydra/launcher={first}", *more)
    assert killed.returncode == 2 and "error: the process of a job was killed" in killed.stderr and "Traceback" not in killed.stderr, killed.stderr
    (tmp_path / "kill2").unlink()
    assert launch("-m", "seed=0,1,2", f"hydra/launcher={first}", *more).returncode == 0
    assert launch("-m", "seed=0,1,2").returncode == 0
    parallel, serial = sweeps(tmp_path)
    assert (parallel / "table.md").read_text() == (serial / "table.md").read_text()


def test_optuna_goes_on_with_the_trials_that_are_missing(launch, tmp_path):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    tune = ("-m", "experiment=tune", "hydra/sweeper=optuna", "hydra.sweeper.sampler.seed=0", "hydra.sweep.dir=runs/tuned")
    for trials in (2, 3):
        result = launch(*tune, f"hydra.sweeper.n_trials={trials}")
        assert result.returncode == 0, result.stderr
    assert result.stdout.count("finished earlier") == 2 and began(tmp_path) == ["100"] * 3


def test_slurm_where_there_is_none_is_said(launch, tmp_path):
    from shutil import which

    if which("srun"):
        pytest.skip("SLURM is installed")
    asked = launch("-m", "seed=0,1", "hydra/launcher=submitit_slurm")
    assert asked.returncode == 2 and "no srun" in asked.stderr and "Traceback" not in asked.stderr and not (tmp_path / "runs").exists()


def test_a_job_that_is_repeated_agrees_or_says_what_differs(launch, tmp_path):
    launch("seed=3")
    (job,) = (path.parent for path in tmp_path.glob("runs/default/*/0/status.json"))
    assert f"agrees with {job}: all 2 figures are equal" in launch(f"rerun={job}").stdout
    (tmp_path / "noisy").touch()
    assert "1 of 2 figures differ" in launch(f"rerun={job}").stdout
    assert launch(f"rerun={job}", "seed=1").returncode == 2
    assert "no job lies in" in launch("rerun=nowhere").stderr


def test_figures_go_to_tensorboard(launch, tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    assert launch("seed=3", "teach.basis.count=20", "tracking=tensorboard").returncode == 0
    (folder,) = tmp_path.glob("runs/default/*/0/tensorboard")
    events = EventAccumulator(str(folder))
    events.Reload()
    assert events.Scalars("teach.mfd")[0].value == pytest.approx(0.025)


def test_figures_go_to_mlflow(launch, tmp_path):
    mlflow = pytest.importorskip("mlflow")
    result = launch("seed=3", "teach.basis.count=20", "tracking=mlflow")
    assert result.returncode == 0, result.stderr
    client = mlflow.MlflowClient(f"sqlite:///{tmp_path}/runs/mlflow.db")
    (run,) = client.search_runs([experiment.experiment_id for experiment in client.search_experiments()])
    assert run.info.status == "FINISHED" and run.data.metrics["teach.mfd"] == pytest.approx(0.025) and run.data.params["seed"] == "3"


def test_a_tracker_that_is_not_installed_is_said_before_the_job(launch, tmp_path):
    from importlib.util import find_spec

    if find_spec("mlflow"):
        pytest.skip("mlflow is installed")
    result = launch("tracking=mlflow")
    assert result.returncode == 2 and "pip install 'scene2skill[mlflow]'" in result.stderr and not (tmp_path / "began.txt").exists()
