"""Where the figures of a job also go, on this machine: no account, no network.

``tracker(settings, figures, run)`` is called when a job has finished. What is missing is said when the job starts.
"""

import os
from importlib.util import find_spec
from pathlib import Path


class TensorBoard:
    """Event files in <run>/tensorboard: tensorboard --logdir runs."""

    def __init__(self):
        _needed("tensorboard")

    def __call__(self, settings: dict, figures: dict[str, float], run: Path) -> None:
        from torch.utils.tensorboard import SummaryWriter

        with SummaryWriter(str(run / "tensorboard")) as writer:
            writer.add_hparams(_flat(settings), figures, run_name=".")


class MLflow:
    """Runs in one local database. store: its address, such as sqlite:///runs/mlflow.db."""

    def __init__(self, store: str):
        _needed("mlflow")
        self.store = store

    def __call__(self, settings: dict, figures: dict[str, float], run: Path) -> None:
        os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
        import mlflow

        mlflow.set_tracking_uri(self.store)
        mlflow.set_experiment(run.parents[1].name)
        with mlflow.start_run(run_name=f"{run.parent.name}/{run.name}"):
            mlflow.log_params(_flat({key: part for key, part in settings.items() if key != "experiment"}))  # its columns have names that no parameter may have
            mlflow.log_metrics(figures)


def _needed(package: str) -> None:
    if find_spec(package) is None:
        raise ValueError(f"tracking={package} needs the package {package}: pip install 'scene2skill[{package}]'")


def _flat(node: dict, above: str = "") -> dict[str, str | int | float | bool]:
    """Settings by their path; what is no number, truth or text becomes text."""
    found = {}
    for key, value in node.items():
        if isinstance(value, dict):
            found |= _flat(value, f"{above}{key}.")
        else:
            found[f"{above}{key}"] = value if isinstance(value, (bool, int, float)) else str(value)[:500]
    return found
