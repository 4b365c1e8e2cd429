"""Every command answers quickly, and bad input gets one clear error, exit code 2 and nothing half written."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
COMMAND = Path(sys.executable).with_name("scene2skill")
MODULES = ("robot.capture", "scene.reconstruct", "scene.train", "scene.mesh", "scene.render", "scene.tags", "teach.draw", "teach.fit", "robot.plan", "robot.execute", "conf.pipeline")  # fmt: skip


def scene2skill(*arguments, cwd):
    return subprocess.run([COMMAND, *arguments], capture_output=True, text=True, cwd=cwd, env=os.environ | {"OMP_NUM_THREADS": "1"})


def photographs(folder, count=4, size=(64, 48), seed=0):
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for i in range(count):
        Image.fromarray(rng.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)).save(folder / f"{i}.png")
    return folder


def refused(result, *words):
    """One clear line, exit code 2, no traceback."""
    lines = [line for line in result.stderr.splitlines() if not line.startswith("Error executing job")]
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr and len(lines) == 1 and lines[0].startswith("error: "), result.stderr
    for word in words:
        assert word in lines[0], lines[0]


@pytest.mark.parametrize("module", MODULES)
def test_help_of_every_command(module):
    result = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0 and "scene2skill" in result.stdout, result.stderr


def test_help_and_the_whole_config_are_printed_without_doing_anything(tmp_path):
    """How fast is a matter of what is imported, which test_architecture holds."""
    assert "world:" in scene2skill("--help", cwd=tmp_path).stdout
    assert "stages:" in scene2skill("--cfg", "job", cwd=tmp_path).stdout
    assert not list(tmp_path.iterdir())


def test_the_command_works_beside_a_foreign_conf_folder(tmp_path):
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "config.yaml").write_text("mine: 1\n")
    (tmp_path / "conf" / "__init__.py").write_text("raise SystemExit('the foreign one')\n")
    assert "scene:" in scene2skill("--cfg", "job", cwd=tmp_path).stdout


def test_a_world_of_ones_own_is_a_file_in_a_folder_of_ones_own(tmp_path):
    (tmp_path / "mine" / "world").mkdir(parents=True)
    world = {"name": "bench", "objects": [{"name": "top", "shape": "box", "size": [0.6, 1.0, 0.04], "position": [0.6, 0.0, 0.1]}],
             "sketch_views": [{"eye": [0.2, -0.75, 1.05], "target": [0.5, 0.0, 0.28], "fov_deg": 50}, {"eye": [0.4, 0.85, 1.0], "target": [0.5, 0.0, 0.28], "fov_deg": 50}],
             "motion": {"via": [[0.307, 0.0, 0.485], [0.44, 0.04, 0.46], [0.52, 0.06, 0.36], [0.55, 0.05, 0.24]]}}  # fmt: skip
    (tmp_path / "mine" / "world" / "bench.yaml").write_text(json.dumps(world))
    own = ("--config-dir", "mine", "world=bench", "scene.truth=true", "stages=[render,sketch]")
    refused(scene2skill(*own, cwd=tmp_path), "view1, view2", "say user.held_out=null")
    assert scene2skill(*own, "user.held_out=null", cwd=tmp_path).returncode == 0
    assert len(list((tmp_path / "data").glob("bench*/views/view?.png"))) == 2


def test_an_unknown_world_names_the_known_ones(tmp_path):
    refused(scene2skill("world=tabel", cwd=tmp_path), "there is no world=tabel: did you mean table?")


def test_an_unknown_setting_is_refused(tmp_path):
    refused(scene2skill("teach.density.hiden=3", cwd=tmp_path), "hiden")


def test_an_unknown_stage_names_the_known_ones(tmp_path):
    refused(scene2skill("stages=[reconstrct]", cwd=tmp_path), "reconstrct", "reconstruct")


def test_a_stage_without_the_files_it_needs_says_which_stage_makes_them(tmp_path):
    refused(scene2skill("stages=[train]", cwd=tmp_path), "train", "reconstruct")


def test_a_path_in_a_file_needs_the_field_first(tmp_path):
    refused(scene2skill("stages=[render]", "scene/paths=file", "scene.paths.file=no.json", cwd=tmp_path), "render", "train")


def test_an_unknown_path_names_the_known_ones(tmp_path):
    refused(scene2skill("stages=[render]", "scene/paths=spirale", cwd=tmp_path), "spirale", "interpolate")


def test_no_such_folder(tmp_path):
    refused(scene2skill("photos=nowhere", cwd=tmp_path), "nowhere")


def test_a_file_that_is_no_video(tmp_path):
    (tmp_path / "walk.mp4").write_text("x")
    refused(scene2skill("photos=walk.mp4", cwd=tmp_path), "walk.mp4", "video")


def test_a_transforms_file_with_cameras_that_leave_its_folder(tmp_path):
    frame = {"file_path": "../secret.png", "transform_matrix": np.eye(4).tolist()}
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "w": 4, "h": 4, "frames": [frame] * 3}))
    refused(scene2skill("photos=transforms.json", cwd=tmp_path), "../secret.png", "outside")


def test_a_damaged_model_of_colmap(tmp_path):
    photographs(tmp_path / "model" / "images")
    (tmp_path / "model" / "sparse" / "0").mkdir(parents=True)
    (tmp_path / "model" / "sparse" / "0" / "cameras.bin").write_bytes(b"x")
    refused(scene2skill("photos=model", cwd=tmp_path), "model/sparse/0", "COLMAP")


def test_a_folder_without_pictures(tmp_path):
    (tmp_path / "empty").mkdir()
    refused(scene2skill("photos=empty", cwd=tmp_path), "empty")


def test_fewer_than_three_pictures(tmp_path):
    photographs(tmp_path / "two", 2)
    refused(scene2skill("photos=two", cwd=tmp_path), "3")


def test_a_truncated_picture_is_named(tmp_path):
    folder = photographs(tmp_path / "cut")
    data = (folder / "2.png").read_bytes()
    (folder / "2.png").write_bytes(data[: len(data) // 2])
    refused(scene2skill("photos=cut", cwd=tmp_path), "2.png")


@pytest.mark.parametrize(("name", "word"), [("tags.json", "tags"), ("arm_poses.json", "base_from_flange"), ("distance.json", "from"), ("poses.json", "frames")])
def test_a_broken_file_of_the_robots_frame_is_named_before_anything_is_reconstructed(tmp_path, name, word):
    folder = photographs(tmp_path / "scene")
    (folder / name).write_text('{"distance": 1}' if name == "distance.json" else '{"family": "36h11"}')
    refused(scene2skill("photos=scene", cwd=tmp_path), name, f"missing {word}")
    assert not list(tmp_path.glob("data/scene/*.json")) and not list(tmp_path.glob("data/scene/images"))


def test_a_frame_without_its_file_names_the_file(tmp_path):
    photographs(tmp_path / "scene")
    refused(scene2skill("photos=scene", "scene/frame=arm", cwd=tmp_path), "arm_poses.json", "scene.frame.file")


def test_pictures_that_do_not_overlap(tmp_path):
    photographs(tmp_path / "noise", 4, (320, 240))
    refused(scene2skill("photos=noise", cwd=tmp_path), "overlap")
    assert not (tmp_path / "data" / "noise" / "transforms.json").exists()


def test_an_arm_without_its_urdf_is_named_before_anything_is_photographed(tmp_path):
    (tmp_path / "mine.yaml").write_text("urdf: mine.urdf\n")
    refused(scene2skill("world=tiny", "robot/arm=file", "robot.arm.name_or_path=mine.yaml", cwd=tmp_path), "no URDF at mine.urdf")
    assert not list(tmp_path.glob("data/*/photos"))


def test_a_world_with_a_negative_size(tmp_path):
    refused(scene2skill("stages=[capture]", "world.objects.0.size=[1,-1,1]", cwd=tmp_path), "size")


def test_a_read_only_folder(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root writes everywhere")
    (tmp_path / "data").mkdir(mode=0o500)
    refused(scene2skill("stages=[capture]", cwd=tmp_path), "data")


def test_a_full_disk(tmp_path):
    """A file size limit stands for the disk: writing beyond it fails with the same kind of error."""
    photographs(tmp_path / "noise", 4, (320, 240))
    limited = f"ulimit -f 1; trap '' XFSZ; exec {COMMAND} photos=noise"
    result = subprocess.run(["bash", "-c", limited], capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 2 and "Traceback" not in result.stderr, result.stderr


def test_planning_among_the_reconstruction_says_that_it_needs_a_mesh(tmp_path):
    from conf.pipeline import STAGES

    refused(scene2skill("robot/obstacles=reconstruction", "stages=[plan]", cwd=tmp_path), "stages=[fit,plan]")
    assert "surface" in [stage.name for stage in STAGES]


def test_two_photographs_without_tags_are_refused(tmp_path):
    photographs(tmp_path / "two", 2)
    refused(scene2skill("photos=two", "scene/resection=tags", "stages=[reconstruct]", cwd=tmp_path), "tags.json")
    (tmp_path / "two" / "tags.json").write_text('{"family": "36h11", "size": 0.1, "tags": {"0": {"base_from_tag": %s}}}' % np.eye(4).tolist())
    refused(scene2skill("photos=two", "scene/resection=tags", "stages=[reconstruct]", cwd=tmp_path), "0 of 2 photographs show a tag")


def test_masks_of_another_size_are_refused(tmp_path):
    photographs(tmp_path / "masked")
    photographs(tmp_path / "masked" / "masks", size=(48, 64))
    refused(scene2skill("photos=masked", "stages=[reconstruct]", cwd=tmp_path), "48x64", "64x48")
