"""The page of a job, from files as the stages write them."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from omegaconf import OmegaConf

from conf.report import write_report
from scene.dataset import save_image

SETTINGS = {"photos": None, "seed": 0, "user": {}, "world": {"name": "tiny"}, "scene": {"seed": 0}}
MESH = {"triangles": 1234, "pieces": 7, "free": 0.25, "unseen": 0.5}


@pytest.fixture
def job(tmp_path):
    """A job that did nothing but a mesh."""
    for folder in ("run", "capture"):
        (tmp_path / folder).mkdir()
    (tmp_path / "run" / "metrics.json").write_text(json.dumps({"surface": MESH, "total_seconds": 3.0}))
    save_image(tmp_path / "capture" / "mesh.png", np.full((48, 64, 3), 99, np.uint8))
    return SimpleNamespace(cfg=OmegaConf.create(SETTINGS), run=tmp_path / "run", capture=tmp_path / "capture")


def test_a_mesh_is_shown_with_its_figures(job):
    page = write_report(job).read_text()
    assert "1234 triangles, 7 convex pieces" in page and "25% is free and 50% unseen" in page
    assert page.count("data:image/png;base64,") == 1


def test_a_job_that_made_no_mesh_shows_none_of_another(job):
    (job.run / "metrics.json").write_text(json.dumps({"total_seconds": 3.0}))
    assert "data:image/png" not in write_report(job).read_text()
