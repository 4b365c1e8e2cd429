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
GIVEN = {"user=files": ["user.file=strokes.json"], "scene/paths=file": ["scene.paths.file=path.json"], "scene/views=next": ["scene.views.sketch=reach"]}


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
    group, name = option.split("/", 1) if option.startswith("experiment/") else option.rsplit("/", 1)
    choice = f"{group}={name}"
    cfg = config(choice, *GIVEN.get(choice, []))
    for node in targets(OmegaConf.masked_copy(cfg, ["user", "scene", "teach", "robot", "world", "experiment", "seed"])):
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


STEPS = [path.stem for path in sorted((CONF / "experiment/ablation").glob("*.yaml"))]


def taught(cfg):
    """The settings of teach, and for each of its parts the option that was chosen."""
    settings = OmegaConf.to_container(cfg.teach)
    chosen = {part: cfg.hydra.runtime.choices[f"teach/{part}"] for part in ("density", "raytrace", "basis")}
    return settings, chosen


def test_one_option_chooses_all_of_the_papers_method(config):
    settings, chosen = taught(config("teach/rptl=paper"))
    assert chosen == {"density": "joint_flow", "raytrace": "authors", "basis": "authors"}
    rptl = settings["rptl"]
    assert (rptl["time"], rptl["covariance"], rptl["robust"], rptl["routes"], rptl["periodic"], rptl["predictive"]) == (
        "drawn", "diagonal", False, False, False, False,
    )  # fmt: skip
    made = {part: instantiate(settings[part]) for part in chosen}
    assert [type(one).__name__ for one in made.values()] == ["JointFlow", "Algorithm1", "SquaredExponential"]
    assert (made["raytrace"].grid, made["raytrace"].samples, made["raytrace"].epsilon) == (100, 150, 0.25)


def test_parts_given_on_the_command_line_win_over_the_papers(config):
    given = ("teach/density=flow", "teach/raytrace=exact", "teach.rptl.time=aligned")
    settings, chosen = taught(config("teach/rptl=paper", *given))
    assert (chosen["density"], chosen["raytrace"], settings["rptl"]["time"]) == ("flow", "exact", "aligned")


def test_the_authors_schedule_is_one_setting(config):
    made = instantiate(config("teach/rptl=paper", "teach/density=joint_flow_authors").teach.density)
    assert (made.steps, made.hidden, made.transforms, made.learning_rate, made.weight_decay, made.noise) == (
        5000, 512, 8, 3e-4, 5e-5, 0.001,
    )  # fmt: skip
    assert made.patience is None and made.schedule == "constant"


def test_the_ablation_sweeps_over_all_its_steps_in_order(config):
    swept = config("experiment=ablation").hydra.sweeper.params
    assert swept["+experiment/ablation"] == "glob(*)" and "seed" in swept
    assert [int(step.split("_")[0]) for step in STEPS] == list(range(len(STEPS)))


def test_table_1_has_rendered_views_and_photographs_by_the_same_cameras(config):
    rendered, photographs = (config("experiment=table1", "+experiment/table1=box", f"+experiment/pictures={name}") for name in ("rendered", "photographs"))
    assert not rendered.scene.truth and photographs.scene.truth and photographs.stages == ["render", "sketch", "fit"]
    assert rendered.user == photographs.user and rendered.world.sketch_views == photographs.world.sketch_views
    assert rendered.hydra.sweeper.params["+experiment/pictures"] == "rendered,photographs"


DEFAULT = next(step for step in STEPS if step.endswith("_default"))


def test_the_ablation_goes_from_the_paper_to_the_default_and_on_to_other_views(config):
    first, default, *views = (config("experiment=ablation", f"+experiment/ablation={step}") for step in (STEPS[0], *STEPS[STEPS.index(DEFAULT) :]))
    assert taught(first) == taught(config("teach/rptl=paper"))
    assert all(taught(cfg) == taught(config()) for cfg in (default, *views))
    assert (default.user.held_out, [cfg.user.held_out for cfg in views]) == ("view3", [None, None])
    assert [cfg.hydra.runtime.choices["scene/views"] for cfg in (default, *views)] == ["default", "default", "suggested"]


@pytest.mark.parametrize("before, after", list(zip(STEPS, STEPS[1 : STEPS.index(DEFAULT) + 1])))
def test_each_step_of_the_ablation_is_the_one_before_and_one_setting(config, before, after):
    (a, chosen_a), (b, chosen_b) = (taught(config(f"experiment=ablation/{step}")) for step in (before, after))
    if after == DEFAULT:
        assert chosen_a == chosen_b and a != b  # the option teach/rptl=default: robust, routes, periodic
        return
    rptl = [key for key in a["rptl"] | b["rptl"] if a["rptl"].get(key) != b["rptl"].get(key)]
    parts = [part for part in chosen_a if chosen_a[part] != chosen_b[part]]
    assert len(rptl + parts) == 1
    assert all(a[part] == b[part] for part in chosen_a if part not in parts)
