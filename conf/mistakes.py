"""What to tell a person about an error: one line, with the names that were perhaps meant."""

import re
import shutil
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, InstantiationException, MissingConfigException
from omegaconf import DictConfig, OmegaConf

PLUGINS = {"joblib": "joblib", "submitit": "slurm", "optuna": "optuna", "ray": "ray"}
"""What to install for a launcher or sweeper: part of its module's name -> extra of pyproject.toml."""
DEATHS = {"BrokenProcessPool", "UncompletedJobError", "WorkerCrashedError", "OutOfMemoryError"}
"""What launchers raise where the process of a job ended without a result: joblib's, submitit's, ray's."""
SEEDS = ("seed", "scene.seed", "world.seed")
OPTION = re.compile(r"(world|user|experiment|(scene|teach|robot)/\w+)=[\w/]+")
"""A choice of one option of one group, on a command line."""
UNKNOWN_KEY = re.compile(r"Could not override '([^']+)'")


def explained(error: Exception, arguments: Sequence[str] = ()) -> str:
    """The error's own words on one line; of a name that does not exist, the nearest ones.

    arguments: the command line, from which it is known whether a person or the experiment asked for that name.
    """
    if isinstance(error, InstantiationException) and isinstance(error.__cause__, ValueError | OSError):
        return explained(error.__cause__)
    plugin = next((extra for name, extra in PLUGINS.items() if f"hydra_plugins.hydra_{name}" in str(error)), None)
    if isinstance(error, InstantiationException) and plugin:
        return f"this launcher is an extra: pip install 'scene2skill[{plugin}]'"
    words = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, MissingConfigException) and error.options:
        group, _, name = (error.missing_cfg_file or "").rpartition("/")
        if group in ("hydra/launcher", "hydra/sweeper") and (extra := PLUGINS.get(name.partition("_")[0])):
            return f"{group}={name} is an extra: pip install 'scene2skill[{extra}]'"
        above = next((key for key, _, value in (a.lstrip("+").partition("=") for a in arguments) if f"{key}/{value}" == f"{group}/{name}"), group)
        name = f"{group}/{name}".removeprefix(f"{above}/")
        return f"there is no {above}={name}{_nearest(name, _options(above, error.options))}; there are {', '.join(error.options)}"
    unknown = UNKNOWN_KEY.search(words) if isinstance(error, HydraException) else None
    if unknown and (swept := _contradiction(unknown[1], arguments)):
        return swept
    if unknown:
        return f"there is no setting {unknown[1]}{_nearest(unknown[1], _keys(arguments))}; --cfg job shows all of them"
    return words


def check_launcher(arguments: list[str]) -> None:
    """Raise ValueError where SLURM is asked for and there is none."""
    if "hydra/launcher=submitit_slurm" in arguments and shutil.which("srun") is None:
        raise ValueError("hydra/launcher=submitit_slurm needs SLURM, and there is no srun on this machine: start it on the cluster's login node, "
                         "or try it here with hydra/launcher=submitit_local")  # fmt: skip


def check_experiment(arguments: list[str]) -> None:
    """Raise ValueError where two experiments are asked for: Hydra would take the last."""
    named = [argument for argument in arguments if argument.startswith("experiment=")]
    if len(named) > 1:
        raise ValueError(f"{' and '.join(named)} contradict each other: name one experiment")


def check_seeds(cfg: DictConfig) -> None:
    """Raise ValueError where a seed is no whole number from 0 on: before minutes are spent on what comes first."""
    for key in SEEDS:
        seed = OmegaConf.select(cfg, key)
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int) or seed < 0):
            raise ValueError(f"{key}={seed} is no seed: give a whole number from 0 on")


def _contradiction(key: str, arguments: Sequence[str]) -> str | None:
    """What to say of a setting that the experiment sweeps over and that another choice on the command line takes away."""
    names = {argument.partition("=")[0].lstrip("+~"): argument for argument in arguments if "=" in argument}
    chosen = [argument for name, argument in names.items() if key.startswith(f"{name.replace('/', '.')}.")]
    if key in names or "experiment" not in names or not chosen:
        return None
    return f"{names['experiment']} sets {key}, which there is not with {' and '.join(chosen)}: leave that out"


def was_killed(error: Exception) -> bool:
    """Whether a launcher says that the process of a job died."""
    return bool(DEATHS & {kind.__name__ for kind in type(error).__mro__})


def _nearest(name: str, names: list[str]) -> str:
    near = get_close_matches(name, names, n=3, cutoff=0.6)
    return f": did you mean {' or '.join(near)}?" if near else ""


def _options(group: str, listed: Sequence[str]) -> list[str]:
    """The options of a group, with those of its folders: experiment=curve/angle is one."""
    root = Path(__file__).parent / group
    return [*listed, *(path.relative_to(root).with_suffix("").as_posix() for path in sorted(root.glob("*/*.yaml")))]


def _keys(arguments: Sequence[str]) -> list[str]:
    """The path of every setting, with the options that the command line chooses."""
    GlobalHydra.instance().clear()
    with initialize_config_module("conf", version_base="1.3"):
        options = [argument for argument in arguments if OPTION.fullmatch(argument)]
        cfg = OmegaConf.to_container(compose("config", overrides=options), resolve=False)

    def paths(node: dict, above: str = "") -> list[str]:
        below = [f"{above}{key}" for key in node]
        return below + [path for key, value in node.items() if isinstance(value, dict) for path in paths(value, f"{above}{key}.")]

    return paths(cfg)
