"""Which pictures of a folder count, what they are called, and which camera took each."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from scene import album, dataset, masks
from scene.inputs import recognise


def picture(width=32, height=24, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def photographs(folder, count=4, suffix=".png", size=(32, 24)):
    folder.mkdir(exist_ok=True)
    for i in range(count):
        Image.fromarray(picture(*size, seed=i)).save(folder / f"p{i}{suffix}")
    return folder


def test_photographs_are_sorted_and_other_files_left_alone(tmp_path):
    photographs(tmp_path, suffix=".JPG")
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "._p0.JPG").write_bytes(b"macOS")
    assert [p.name for p in album.load_photographs(tmp_path)] == ["p0.JPG", "p1.JPG", "p2.JPG", "p3.JPG"]


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such folder.*nowhere"):
        album.load_photographs(tmp_path / "nowhere")


def test_a_folder_without_pictures_says_what_is_there(tmp_path):
    (tmp_path / "a.heic").write_bytes(b"x")
    with pytest.raises(FileNotFoundError, match=r"no pictures.*\.jpg.*1 \.heic"):
        album.load_photographs(tmp_path)


def test_two_pictures_are_too_few(tmp_path):
    with pytest.raises(ValueError, match="2 pictures.*at least 3"):
        album.load_photographs(photographs(tmp_path, 2))


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".bmp"])
def test_a_truncated_picture_is_named(tmp_path, suffix):
    photographs(tmp_path, 4, suffix, (200, 150))
    broken = tmp_path / f"p2{suffix}"
    content = broken.read_bytes()
    broken.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(ValueError, match=f"truncated picture.*p2{suffix}"):
        album.load_photographs(tmp_path)


def test_a_picture_that_is_none_is_named(tmp_path):
    photographs(tmp_path)
    (tmp_path / "p9.jpg").write_bytes(b"")
    with pytest.raises(ValueError, match="p9.jpg"):
        album.load_photographs(tmp_path)


def test_two_pictures_of_one_name_are_refused(tmp_path):
    photographs(tmp_path)
    Image.fromarray(picture()).save(tmp_path / "p1.jpg")
    with pytest.raises(ValueError, match="p1.jpg.*p1.png"):
        album.load_photographs(tmp_path)


def taken(path, size=(32, 24), model=None, millimetres=None, turned=None):
    """A photograph with what its EXIF may tell."""
    exif = Image.Exif()
    if model:
        exif[0x0110] = model
    if turned:
        exif[0x0112] = turned
    if millimetres:
        exif.get_ifd(0x8769)[0x920A] = millimetres
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture(*size)).save(path, exif=exif)


def test_sizes_are_compared_after_exif_rotation(tmp_path):
    photographs(tmp_path, suffix=".jpg")
    taken(tmp_path / "turned.jpg", (24, 32), turned=6)
    assert dataset.load_image(tmp_path / "turned.jpg").shape == (24, 32, 3)
    assert dataset.is_rotated(tmp_path / "turned.jpg") and not dataset.is_rotated(tmp_path / "p0.jpg")
    assert album.size(tmp_path / "turned.jpg") == (32, 24)
    assert len(album.cameras(album.load_photographs(tmp_path))) == 1


def test_a_turned_phone_is_two_cameras(tmp_path):
    photographs(tmp_path, count=3)
    for i in range(2):
        taken(tmp_path / f"portrait{i}.png", (24, 32))
    groups = album.cameras(album.load_photographs(tmp_path))
    assert [[p.stem for p in group] for group in groups] == [["p0", "p1", "p2"], ["portrait0", "portrait1"]]
    assert album.described(groups) == "2 cameras: 3 of 32x24, 2 of 24x32"


def test_cameras_of_one_size_are_told_apart_by_model_and_focal_length(tmp_path):
    for i, (model, millimetres) in enumerate([("A", 4.2), ("A", 2.1), ("B", 4.2), ("A", 4.2)]):
        taken(tmp_path / f"{i}.jpg", model=model, millimetres=millimetres)
    groups = album.cameras(album.load_photographs(tmp_path))
    assert [[p.stem for p in group] for group in groups] == [["0", "3"], ["1"], ["2"]]


def test_each_subfolder_is_a_camera_and_names_its_photographs(tmp_path):
    for folder in ("right", "left"):
        for i in range(2):
            taken(tmp_path / folder / f"{i:04d}.png")
    for folder in ("masks", "sparse", "images_4", ".thumbnails", "empty/deeper"):
        taken(tmp_path / folder / "0000.png")
    found = album.load_photographs(tmp_path)
    assert list(album.named(found)) == ["left_0000", "left_0001", "right_0000", "right_0001"]
    assert album.described(album.cameras(found)) == "2 cameras: left 2 of 32x24, right 2 of 32x24"
    went_in = {path.relative_to(tmp_path).as_posix() for path in recognise(tmp_path).files()}
    assert went_in == {*(f"{f}/000{i}.png" for f in ("left", "right") for i in (0, 1)), "masks/0000.png"}


def test_subfolders_do_not_count_beside_pictures_of_the_folder_itself(tmp_path):
    photographs(tmp_path, 3)
    taken(tmp_path / "rejected" / "p7.png")
    assert album.unused(tmp_path) == [tmp_path / "rejected"]
    assert list(album.named(album.load_photographs(tmp_path))) == ["p0", "p1", "p2"]
    assert [path.name for path in recognise(tmp_path).files()] == ["p0.png", "p1.png", "p2.png"]


def test_photographs_of_one_subfolder_alone_go_by_their_own_names(tmp_path):
    photographs(tmp_path / "images", 3)
    assert list(album.named(album.load_photographs(tmp_path))) == ["p0", "p1", "p2"]


def test_two_photographs_of_one_name_are_refused_with_both_paths(tmp_path):
    for name in ("a/b_1.png", "a/2.png", "a_b/1.png"):
        taken(tmp_path / name)
    with pytest.raises(ValueError, match=r"called a_b_1: .*a/b_1.png and .*a_b/1.png"):
        album.load_photographs(tmp_path)


def test_masks_go_by_the_names_of_photographs_in_subfolders(tmp_path):
    for name in ("left/1.png", "left/2.png", "right/1.png"):
        taken(tmp_path / name)
    shown = np.ones((24, 32), bool)
    dataset.save_mask(tmp_path / "masks" / "right_1.png", shown)
    found = album.load_photographs(tmp_path)
    assert masks.find(found) == {"right_1": tmp_path / "masks" / "right_1.png"}
    dataset.save_mask(tmp_path / "masks" / "right" / "1.png", shown)
    with pytest.raises(ValueError, match="masks in a subfolder are not read"):
        masks.find(found)


FILE = st.text("ab_1", min_size=1, max_size=3)


@given(st.sets(st.tuples(FILE, FILE), min_size=1, max_size=5))
def test_names_are_unique_or_refused(paths):
    given_paths = [Path("photos") / folder / f"{file}.jpg" for folder, file in sorted(paths)]
    try:
        assert list(album.named(given_paths).values()) == given_paths
    except ValueError as error:
        assert "are called" in str(error)
