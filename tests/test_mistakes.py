"""What a person is told of a wrong command line: one line, with the names that were perhaps meant."""

import pytest
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from conf.mistakes import check_experiment, check_seeds, explained


def said_of(*arguments):
    """What is said where the command line does not compose."""
    swept = {"experiment=letters": ["world.motion.letter=B"]}
    with initialize_config_module("conf", version_base="1.3"), pytest.raises(Exception) as caught:
        compose("config", overrides=[*arguments, *(one for a in arguments for one in swept.get(a, []))], return_hydra_config=True)
    GlobalHydra.instance().clear()
    return explained(caught.value, arguments)


@pytest.mark.parametrize("arguments, said", [
    (["experiment=curve/angel"], "there is no experiment=curve/angel: did you mean curve/angle"),
    (["experiment=leters"], "there is no experiment=leters: did you mean letters?"),
    (["teach.denisty.hidden=3"], "there is no setting teach.denisty.hidden: did you mean teach.density.hidden"),
    (["world=board", "world.motion.leter=B"], "there is no setting world.motion.leter: did you mean world.motion.letter"),
    (["experiment=letters", "world=table"], "experiment=letters sets world.motion.letter, which there is not with world=table: leave that out"),
    (["experiment=letters", "world=table", "world.motion.letter=Z"], "there is no setting world.motion.letter"),
])  # fmt: skip
def test_names_that_there_are_not_are_told_with_those_that_were_perhaps_meant(arguments, said):
    found = said_of(*arguments)
    assert found.startswith(said) and "\n" not in found


def test_two_experiments_contradict_each_other():
    with pytest.raises(ValueError, match="experiment=curve and experiment=ablation contradict"):
        check_experiment(["-m", "experiment=curve", "seed=0", "experiment=ablation"])


def test_what_a_part_says_of_its_settings_is_said_without_hydras_frame():
    from hydra.utils import instantiate

    with pytest.raises(Exception) as caught:
        instantiate({"_target_": "robot.arm.Arm.load", "name_or_path": "nope.yaml"})
    assert explained(caught.value) == "no arm file nope.yaml"


@pytest.mark.parametrize("choice, extra", [("hydra/launcher=ray", "ray"), ("hydra/launcher=submitit_slurm", "slurm"), ("hydra/sweeper=optuna", "optuna")])
def test_a_launcher_that_is_not_installed_says_what_to_install(choice, extra):
    from hydra.errors import MissingConfigException

    group, _, name = choice.partition("=")
    missing = MissingConfigException("not found", f"{group}/{name}", ["basic"])
    assert explained(missing) == f"{choice} is an extra: pip install 'scene2skill[{extra}]'"
    assert explained(MissingConfigException("not found", f"{group}/basik", ["basic"])).startswith(f"there is no {group}=basik: did you mean basic?")


@pytest.mark.parametrize("key", ["seed", "scene.seed", "world.seed"])
@pytest.mark.parametrize("seed", [-1, 1.5, "abc", "", True])
def test_a_seed_is_a_whole_number_from_0_on(key, seed):
    cfg = OmegaConf.create({"seed": 0, "scene": {"seed": 3}, "world": {}})
    check_seeds(cfg)
    OmegaConf.update(cfg, key, seed)
    with pytest.raises(ValueError, match=f"{key}={seed} is no seed"):
        check_seeds(cfg)
