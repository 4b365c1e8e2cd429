"""Rows, intervals and paired tests of a sweep against their definitions; what is wrong with a folder is said."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from conf import gallery, growth, short, table
from conf.results import JobResult, Results, Row, collect, interval, markdown, paired

ROOT = Path(__file__).parents[1]
SPEC = {"over": ["seed"], "columns": {"MFD": ["teach.mfd", 100], "success": ["execute.success", 1]}, "rows": {}, "objective": None}


def job(folder, number, overrides, metrics, *, state="finished", sketches=None, git="abc", spec=SPEC):
    """A job's folder as the pipeline leaves it."""
    place = folder / str(number)
    (place / ".hydra").mkdir(parents=True)
    (place / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))
    (place / ".hydra" / "config.yaml").write_text(yaml.safe_dump({"experiment": spec}))
    (place / "status.json").write_text(json.dumps({"state": state} | ({"error": "it broke"} if state == "failed" else {})))
    (place / "provenance.json").write_text(json.dumps({"git": git}))
    (place / "metrics.json").write_text(json.dumps(metrics))
    if sketches is not None:
        (place / "sketches.json").write_text(sketches)


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30))
def test_the_interval_is_students(values):
    mean, std, n, low, high = interval(np.array([*values, np.nan]))
    assert n == len(values) and mean == pytest.approx(np.mean(values), abs=1e-9) and std == pytest.approx(np.std(values, ddof=1), abs=1e-9)
    if std > 1e-6 and set(values) - {0, 1}:
        expected = stats.t.interval(0.95, n - 1, loc=np.mean(values), scale=stats.sem(values))
        np.testing.assert_allclose((low, high), expected, rtol=1e-6, atol=1e-6)


@given(st.lists(st.booleans(), min_size=2, max_size=30))
def test_the_interval_of_successes_holds_the_rates_that_are_within_two_deviations_of_what_was_seen(successes):
    mean, _, n, low, high = interval(np.array(successes, dtype=float))
    for rate in (low, high):
        assert abs(rate - mean) == pytest.approx(stats.norm.ppf(0.975) * np.sqrt(rate * (1 - rate) / n), abs=1e-9)
    assert 0 <= low <= mean <= high <= 1 and low < high


def test_one_value_has_no_interval():
    mean, std, n, *_ = interval(np.array([3.0]))
    assert (mean, n) == (3.0, 1) and np.isnan(std)


def test_pairs_are_of_the_same_sketches_only():
    a = Row({"m": "a"}, np.arange(7.0)[:, None], tuple("pqrstuv"))
    b = Row({"m": "b"}, np.array([1.0, 3, 2.5, 5, 7, 9, 0])[:, None], tuple("qrstuvw"))
    n, difference, p = paired(b, a, 0)
    differences = np.array([1.0, 3, 2.5, 5, 7, 9]) - np.arange(1.0, 7)
    assert (n, difference) == (6, pytest.approx(differences.mean())) and p == pytest.approx(stats.wilcoxon(differences).pvalue)
    assert paired(a, Row({}, np.zeros((7, 1)), (None,) * 7), 0) is None


def test_rows_are_configurations_and_seeds_repeat_them(tmp_path):
    for i in range(6):
        job(tmp_path, i, [f"seed={i % 3}", f"+experiment/ablation={i // 3}", "data=x"], {"teach": {"mfd": 0.01 * (i + 1)}}, sketches=str(i % 3))
    results = collect([tmp_path])
    assert [row.settings for row in results.rows] == [{"experiment/ablation": "0"}, {"experiment/ablation": "1"}]
    np.testing.assert_allclose(results.rows[1].values[:, 0], [4, 5, 6])
    assert list(results.columns) == ["MFD"]  # no job performed anything
    assert "| 0 | 3 | 2 ± 1 | -0.484 to 4.48 |" in markdown(results)


def test_methods_that_a_job_measures_beside_its_own_are_rows(tmp_path):
    spec = SPEC | {"rows": {"learned": "", "oracle": "oracle_"}}
    for i in range(2):
        job(tmp_path, i, [f"seed={i}"], {"teach": {"mfd": 0.03, "oracle_mfd": 0.02}}, spec=spec)
    assert [(row.settings["method"], row.values.mean()) for row in collect([tmp_path]).rows] == [("learned", 3), ("oracle", 2)]


def test_what_is_missing_or_mixed_is_said(tmp_path):
    job(tmp_path, 0, ["seed=0"], {"teach": {"mfd": 0.01}})
    job(tmp_path, 1, ["seed=1"], {}, state="failed")
    job(tmp_path, 2, ["seed=2"], {"teach": {"mfd": 0.01}}, state="running")
    job(tmp_path, 3, ["seed=3"], {"teach": {"mfd": float("nan")}, "execute": {"success": True}}, git="def")
    said = markdown(collect([tmp_path]))
    assert "2 of 4 jobs finished" in said and "1 (seed=1): failed, it broke" in said and "2 (seed=2): did not come to its end" in said
    assert "2 (seed=2): did not come to its end, killed" in said and "2 versions of the code" in said and "MFD: 1 jobs have no figure" in said and "success: 1 jobs" in said


def test_a_job_of_whose_only_figure_nothing_is_finite_is_said_too(tmp_path):
    for i, mfd in enumerate((0.01, float("nan"), 0.03)):
        job(tmp_path, i, [f"seed={i}"], {"teach": {"mfd": mfd}})
    said = markdown(collect([tmp_path]))
    assert "MFD: 1 jobs have no figure" in said and "| 3 | 2 ± 1.4 (n=2) |" in said
    gallery.write(collect([tmp_path]), tmp_path)


def test_a_row_without_a_finite_figure_has_a_dash(tmp_path):
    job(tmp_path, 0, ["teach.noise=1"], {"teach": {"mfd": float("nan")}})
    job(tmp_path, 1, ["teach.noise=2"], {"teach": {"mfd": 0.01}})
    assert "| 1 | 1 | - (n=0) |" in markdown(collect([tmp_path]))
    gallery.write(collect([tmp_path]), tmp_path)


def test_how_often_something_succeeded_is_counted(tmp_path):
    for i in range(4):
        job(tmp_path, i, [f"seed={i}"], {"execute": {"success": i > 0}})
    assert "| 4 | 3 of 4 | 0.301 to 0.954 |" in markdown(collect([tmp_path]))


def test_a_file_that_no_sweep_wrote_is_named(tmp_path):
    job(tmp_path, 0, ["seed=0"], {"teach": {"mfd": 0.01}})
    (tmp_path / "sweep.json").write_text("[]")
    with pytest.raises(ValueError, match="not what a sweep writes"):
        collect([tmp_path])


def test_several_sweeps_make_one_table(tmp_path):
    job(tmp_path / "a", 0, ["teach/rptl=default"], {"teach": {"mfd": 0.01}})
    job(tmp_path / "b", 0, ["teach/rptl=paper"], {"teach": {"mfd": 0.02}})
    assert [row.settings["teach/rptl"] for row in collect([tmp_path / "a", tmp_path / "b"]).rows] == ["default", "paper"]


def test_the_command_writes_every_file_and_the_csv_holds_every_figure(tmp_path, capsys):
    for i in range(9):
        job(tmp_path, i, [f"seed={i % 3}", f"teach.noise={i // 3}"], {"teach": {"mfd": 0.01 * i}, "execute": {"success": i > 2}})
    assert table.main([str(tmp_path)]) == 0
    with (tmp_path / "results.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 9 and float(lines[4]["teach.mfd"]) == 0.04 and lines[4]["teach.noise"] == "1"
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"teach.mfd.png", "execute.success.png"}
    assert "data:image/png" in (tmp_path / "report.html").read_text() and "teach.noise" in capsys.readouterr().out


def test_an_empty_or_foreign_folder_is_refused(tmp_path, capsys):
    assert table.main([str(tmp_path)]) == 2 and "no job of a sweep" in capsys.readouterr().err
    assert table.main([str(tmp_path / "absent")]) == 2 and "there is no folder" in capsys.readouterr().err
    (tmp_path / "0").mkdir()
    for foreign in ("not json", "[]", "{}", '"text"'):
        (tmp_path / "0" / "status.json").write_text(foreign)
        assert table.main([str(tmp_path)]) == 2 and "status.json" in capsys.readouterr().err
    (tmp_path / "0" / "status.json").write_text('{"state": "finished"}')
    (tmp_path / "0" / "metrics.json").write_text("[1]")
    assert table.main([str(tmp_path)]) == 2 and "metrics.json holds no figures" in capsys.readouterr().err


def test_names_from_outside_are_escaped_in_the_page(tmp_path):
    named = JobResult(tmp_path / "0", "failed", "<script>alert(1)</script>", {"seed": "<b>"}, {}, None, None)
    page = gallery.write(Results((named,), ("seed",), {}, {}), tmp_path).read_text()
    assert "<script>alert" not in page and "&lt;script&gt;" in page


def test_figures_that_are_not_finite_are_left_out_of_everything(tmp_path):
    for i, value in enumerate((1.0, float("nan"), float("inf"), 3.0)):
        job(tmp_path, i, [f"seed={i}", f"teach.noise={i}"], {"teach": {"mfd": value}, "execute": {"success": 1}})
    assert table.main([str(tmp_path)]) == 0
    said = (tmp_path / "table.md").read_text()
    assert "2 jobs have no figure, or not a finite one" in said and "nan ±" not in said and "inf" not in said.replace("finite", "")


@given(st.floats(-3, 3), st.floats(0.1, 10))
def test_a_power_law_has_its_exponent(b, a):
    x = np.array([1.0, 3, 10, 40])
    fitted, half = growth.exponent(x, a * x**b)
    assert fitted == pytest.approx(b, abs=1e-9) and half < 1e-6


def test_growth_is_told_of_the_setting_of_numbers_where_it_is_asked_for(tmp_path):
    spec = SPEC | {"columns": {"fit, s": ["teach.seconds", 1]}, "growth": True}
    for i in range(8):
        job(tmp_path, i, [f"user.strokes={2**(i // 2)}", f"seed={i % 2}"], {"teach": {"seconds": 0.5 * 4.0 ** (i // 2)}}, spec=spec)
    assert list(growth.said(collect([tmp_path]))) == ["fit, s grows as user.strokes^2.00 (± 0.00): 0.5 at 1, 32 at 8"]


def test_what_many_need_is_the_fit_times_their_number(tmp_path):
    spec = SPEC | {"columns": {"fit, s": ["teach.seconds", 1], "fit, MB": ["teach.peak_mb", 1], "disk": ["teach.disk_mb", 1]}, "growth": True,
                   "on_paper": {"of": "a thousand skills", "times": 1000, "at": 4, "seconds": ["fit, s", "plan, s"], "memory": ["fit, MB"], "disk": ["disk"]}}  # fmt: skip
    for i, strokes in enumerate((1, 2, 8)):
        job(tmp_path, i, [f"user.strokes={strokes}"], {"teach": {"seconds": 3.6 * strokes**2, "peak_mb": 1024, "disk_mb": 0.512 * strokes}}, spec=spec)
    *_, said = growth.said(collect([tmp_path]))
    assert "a thousand skills need 16 hours of this machine" in said and "2 GB of disk and 1 GB of memory" in said
    assert "over user.strokes from 1 to 8, times 1,000" in said and "outside" not in said


SHORT = SPEC | {"columns": {"MFD": ["teach.mfd", 100], "WD": ["teach.wd", 100]}, "rows": {"learned": "", "oracle": "oracle_"}, "across": ["world"],
                "published": {"the paper": {"box": "3.9 / 2.9"}}}  # fmt: skip


def swept(folder):
    """Two methods on two worlds, two seeds each."""
    for i, (method, world, seed) in enumerate((m, w, s) for m in ("default", "paper") for w in ("table", "box") for s in (0, 1)):
        figures = {"mfd": 0.02 + 0.01 * seed + 0.1 * (method == "paper"), "wd": 0.05, "oracle_mfd": 0.01, "oracle_wd": 0.01}
        job(folder, i, [f"teach/rptl={method}", f"world={world}", f"seed={seed}"], {"teach": figures}, spec=SHORT, sketches=f"{world}{seed}")
    return collect([folder])


def test_in_the_short_form_worlds_stand_side_by_side(tmp_path):
    lines = short.markdown(swept(tmp_path)).splitlines()
    assert lines[0] == "| MFD / WD | table | box |" and lines[-1] == "| the paper |  | 3.9 / 2.9 |"
    assert lines[2] == "| default, learned | 2.5 ± 0.7 / 5.0 ± 0.0 | 2.5 ± 0.7 / 5.0 ± 0.0 |"
    assert [line.split("|")[1].strip() for line in lines[2:]] == ["default, learned", "oracle", "paper, learned", "the paper"]


def test_what_was_published_stands_beside_the_world_that_was_swept_alone(tmp_path):
    spec = SHORT | {"published": {"the paper": {"table": "3.1 / 2.6", "box": "3.9 / 2.9"}}}
    for seed in (0, 1):
        job(tmp_path / "runs", seed, ["world=box", f"seed={seed}"], {"teach": {"mfd": 0.02, "wd": 0.02}}, spec=spec)
    results = collect([tmp_path / "runs"])
    assert short.markdown(results).splitlines()[-1] == "| the paper | 3.9 / 2.9 |"
    short.keep(results, tmp_path / "kept.json")
    assert short.markdown(short.kept(tmp_path / "kept.json")) == short.markdown(results)
    page = gallery.write(results, tmp_path / "runs").read_text()
    assert "<td>the paper<td>3.9 / 2.9" in page and 'href="1/"' in page


def test_an_experiments_name_is_told_only_where_settings_leave_it_open(tmp_path):
    both = [("teach/rptl=default", "table1"), ("teach/rptl=paper", "table1_paper"), ("teach/rptl=paper", "other")]
    for number, (method, experiment) in enumerate(both):
        job(tmp_path, number, [method, f"experiment={experiment}"], {"teach": {"mfd": 0.02}})
    two = Results(jobs := collect([tmp_path]).jobs, ["seed"], {"MFD": ("teach.mfd", 100)}, {}).varied
    assert two == ["teach/rptl", "experiment"]
    assert Results(jobs[:2], ["seed"], {"MFD": ("teach.mfd", 100)}, {}).varied == ["teach/rptl"]
    assert Results(jobs[1:], ["seed"], {"MFD": ("teach.mfd", 100)}, {}).varied == ["experiment"]


def test_in_the_short_form_what_belongs_together_stands_together(tmp_path):
    spec = SHORT | {"across": ["world", "user.draws_on"]}
    for number, (world, on) in enumerate([("box", "rendered"), ("table", "rendered"), ("table", "photographs"), ("box", "photographs")]):
        job(tmp_path, number, [f"world={world}", f"user.draws_on={on}"], {"teach": {"mfd": 0.02, "wd": 0.02}}, spec=spec)
    head = short.markdown(collect([tmp_path])).splitlines()[0]
    assert head == "| MFD / WD | box, rendered | box, photographs | table, rendered | table, photographs |"


def test_what_is_kept_makes_the_same_table_in_the_readme(tmp_path):
    results = swept(tmp_path / "runs")
    short.keep(results, tmp_path / "docs" / "table1.json")
    table_again = short.markdown(short.kept(tmp_path / "docs" / "table1.json"))
    assert table_again == short.markdown(results)
    readme = tmp_path / "README.md"
    for old in ("", "| old |\n"):
        readme.write_text(f"before\n<!-- table1 -->\n{old}<!-- end -->\nafter\n")
        assert short.write_readme(readme, "table1", table_again) and not short.write_readme(readme, "other", table_again)
        assert readme.read_text() == f"before\n<!-- table1 -->\n{table_again}\n<!-- end -->\nafter\n"


KEPT = sorted((ROOT / "docs" / "results").glob("*.json"))


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
def test_the_readmes_tables_are_those_of_the_kept_results(path):
    assert short.in_readme((ROOT / "README.md").read_text(encoding="utf-8"), path.stem) == short.markdown(short.kept(path))
