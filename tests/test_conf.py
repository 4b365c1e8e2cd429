"""Every option of every group composes, and stands for something that can be made."""

import inspect
from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from hydra.utils import instantiate
from omegaconf import OmegaConf

CONF = Path(__file__).parents[1] / "conf"
OPTIONS = sorted(
    path.relative_to(CONF).with_suffix("").as_posix() for path in CONF.rglob("*.yaml") if path.name != "config.yaml"
)
GIVEN = {"user=files": ["user.file=strokes.json"], "scene/paths=file": ["scene.paths.file=path.json"]}


@pytest.fixture
def config():
    with initialize_config_module("conf", version_base="1.3"):
        yield lambda *overrides: compose("config", overrides=list(overrides), return_hydra_config=True)


def targets(node):
    """Every sub-config that names a class or function."""
    if OmegaConf.is_dict(node):
        if "_target_" in node:
            yield node
        for key in node:
            yield from targets(node[key])


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_composes_and_every_target_takes_its_settings(config, option):
    group, name = option.rsplit("/", 1)
    choice = f"{group}={name}"
    cfg = config(choice, *GIVEN.get(choice, []))
    for node in targets(OmegaConf.masked_copy(cfg, ["user", "scene", "teach", "robot", "world"])):
        made = instantiate(node, _convert_="all")
        if callable(made) and hasattr(made, "func"):  # a function that waits for its arguments
            unknown = set(made.keywords) - set(inspect.signature(made.func).parameters)
            assert not unknown, f"{option} gives {made.func.__name__} settings it does not know: {unknown}"


@pytest.mark.parametrize("option", [option for option in OPTIONS if option.split("/")[0] in ("scene", "teach", "robot")])
def test_the_path_of_a_setting_is_the_path_of_its_code(option):
    room, part, _ = option.split("/")
    target = OmegaConf.load(CONF / f"{option}.yaml").get("_target_")
    if target is None:
        assert (CONF.parent / room / f"{part}.py").exists()
    else:
        assert target.startswith(f"{room}.{part}."), f"{option} configures {target}"


def test_settings_win_over_the_defaults_and_experiments_over_settings(config):
    cfg = config("seed=7")
    assert (cfg.seed, cfg.scene.seed) == (7, 0)


def test_no_config_tells_the_robot_where_the_goal_is(config):
    assert "goal" not in OmegaConf.to_yaml(OmegaConf.masked_copy(config(), ["teach", "robot", "scene"]))
