"""What was given is recognised, and a scene is called after it."""

import pytest

from scene.inputs import recognise, scene_name


def touched(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")
    return folder


@pytest.mark.parametrize(
    ("names", "kind", "path"),
    [
        (["a.jpg"], "photographs", "."),
        (["transforms.json", "images/a.png", "colmap/sparse/0/cameras.bin"], "transforms", "transforms.json"),
        (["transforms_train.json"], "transforms", "transforms_train.json"),
        (["images/a.png", "sparse/0/cameras.bin"], "colmap", "sparse/0"),
        (["images/a.png", "sparse/cameras.txt"], "colmap", "sparse"),
    ],
)
def test_a_folder_is_recognised_by_what_it_holds(tmp_path, names, kind, path):
    source = recognise(touched(tmp_path, *names))
    assert (source.kind, source.path, source.folder) == (kind, tmp_path / path, tmp_path)
    assert source.posed == (kind in ("transforms", "colmap"))


@pytest.mark.parametrize(("name", "kind"), [("walk.MP4", "video"), ("walk.mov", "video"), ("mine.json", "transforms")])
def test_a_file_is_recognised_by_its_ending(tmp_path, name, kind):
    source = recognise(touched(tmp_path, name) / name)
    assert (source.kind, source.folder) == (kind, tmp_path)


def test_what_is_none_of_them_is_refused(tmp_path):
    touched(tmp_path, "a.pdf", "model/sparse/0/cameras.bin")
    with pytest.raises(ValueError, match="a.pdf is neither"):
        recognise(tmp_path / "a.pdf")
    with pytest.raises(FileNotFoundError, match="no such.*nowhere"):
        recognise(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match="no folder images"):
        recognise(tmp_path / "model")


def test_a_scene_is_called_after_its_folder_or_video(tmp_path):
    names = {"desk": "desk", "desk/walk.mp4": "walk", "desk/transforms.json": "desk", "v1.2": "v1.2"}
    assert {given: scene_name(tmp_path / given) for given in names} == names


def test_all_files_that_go_in_are_named(tmp_path):
    touched(tmp_path, "images/sub/a.png", "sparse/0/cameras.bin", "sparse/0/images.bin")
    assert [path.name for path in recognise(tmp_path).files()] == ["a.png", "cameras.bin", "images.bin"]
