"""Stages are done once, go on after a kill, and leave no half file."""

import json

import numpy as np
import pytest
from omegaconf import OmegaConf

from conf import stages
from conf.motion_stages import asked
from conf.stages import Job, Record, Stage


def job(tmp_path, number=0, **settings):
    run = tmp_path / "runs" / "default" / f"t{number}" / "0"
    run.mkdir(parents=True)
    return Job(OmegaConf.create({"seed": 0, "size": 1} | settings), tmp_path / "data", run)


def counting(name="count", **kwargs):
    """A stage that counts how often it was built."""
    built = []

    def build(job, out):
        built.append(job)
        (out / "result.txt").write_text(str(job.cfg.size))
        return {"size": job.cfg.size}

    return Stage(name, build, ("result.txt",), settings=("size",), **kwargs), built


def close(job, state):
    stages.write_json(job.run / "status.json", {"state": state, "capture": str(job.capture)})


def test_a_sketch_file_that_was_mended_is_read_anew(tmp_path):
    file = tmp_path / "reach.json"
    one = job(tmp_path, user={"kind": "files", "file": str(file)})
    file.write_text("broken")
    before = asked(one)
    assert asked(one) == before
    file.write_text("whole")
    assert asked(one) != before


def test_a_shared_stage_is_done_once_for_equal_settings(tmp_path):
    stage, built = counting(shared=True)
    first = stages.run(stage, job(tmp_path, 0), {})
    again = stages.run(stage, job(tmp_path, 1), {})
    assert len(built) == 1 and again.reused and not first.reused and again.metrics == {"size": 1}


def test_another_setting_or_another_input_does_it_again(tmp_path):
    stage, built = counting(shared=True)
    stages.run(stage, job(tmp_path, 0), {})
    stages.run(stage, job(tmp_path, 1, size=2), {})
    stages.run(stage, job(tmp_path, 2, size=2, seed=5), {})
    assert len(built) == 2
    needing, built = counting("needing", shared=True, needs=("before",))
    stages.run(needing, job(tmp_path, 3), {"before": Record("a", {}, 0)})
    stages.run(needing, job(tmp_path, 4), {"before": Record("b", {}, 0)})
    assert len(built) == 2


def test_a_missing_output_is_made_again(tmp_path):
    stage, built = counting(shared=True)
    here = job(tmp_path)
    stages.run(stage, here, {})
    (here.capture / "result.txt").unlink()
    stages.run(stage, here, {})
    assert len(built) == 2


def test_a_stage_that_is_stopped_leaves_the_old_result_whole(tmp_path):
    stage, _ = counting(shared=True)
    here = job(tmp_path)
    stages.run(stage, here, {})

    def stopped(job, out):
        (out / "result.txt").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stages.run(Stage("count", stopped, ("result.txt",), settings=("size",), shared=True), job(tmp_path, 1, size=2), {})
    assert (here.capture / "result.txt").read_text() == "1"
    assert stages.find(stage, here.capture).metrics == {"size": 1}


def test_only_a_resumable_stage_finds_its_unfinished_folder_again(tmp_path):
    seen = []

    def build(job, out):
        seen.append((out / "checkpoint").exists())
        (out / "checkpoint").write_text("half")
        raise KeyboardInterrupt

    here = job(tmp_path)
    for resumable in (True, True, False, False):
        with pytest.raises(KeyboardInterrupt):
            stages.run(Stage("train", build, (), shared=True, resumable=resumable), here, {})
    assert seen == [False, True, False, False]


def test_a_run_goes_on_from_one_that_was_interrupted_but_not_from_one_that_finished(tmp_path):
    stage, built = counting()
    first = job(tmp_path, 0)
    stages.run(stage, first, {})
    close(first, "interrupted")
    second = job(tmp_path, 1)
    assert stages.run(stage, second, {}).reused and (second.run / "result.txt").read_text() == "1"
    close(first, "finished")
    close(second, "finished")
    assert not stages.run(stage, job(tmp_path, 2), {}).reused
    assert len(built) == 2


def test_foreign_files_among_the_runs_do_no_harm(tmp_path):
    stage, _ = counting()
    for name, text in (("a", "not json"), ("b", "[]"), ("c", "")):
        folder = tmp_path / "runs" / "default" / name / "0"
        folder.mkdir(parents=True)
        (folder / "status.json").write_text(text)
    assert not stages.run(stage, job(tmp_path, 0), {}).reused


def test_written_json_is_whole(tmp_path):
    stages.write_json(tmp_path / "a.json", {"a": 1.5})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1.5}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_a_scene_takes_from_the_one_beside_it_what_is_the_same_there(tmp_path):
    stage, built = counting(shared=True)
    first, second, third = (Job(here.cfg, tmp_path / "data" / name, here.run) for name, here in
                            (("a", job(tmp_path, 0)), ("b", job(tmp_path, 1)), ("c", job(tmp_path, 2, size=2))))  # fmt: skip
    stages.run(stage, first, {})
    assert stages.run(stage, second, {}).reused and (second.capture / "result.txt").read_text() == "1"
    assert not stages.run(stage, third, {}).reused and len(built) == 2


def test_the_memory_of_a_stage_is_its_own(tmp_path):
    def build(size):
        def grows(job, out):
            return {"sum": float(np.ones(size).sum())}

        return grows

    large, small = (stages.run(Stage(name, build(size), ()), job(tmp_path, size), {}) for name, size in (("large", 40_000_000), ("small", 10)))
    assert large.peak_mb - small.peak_mb > 250
