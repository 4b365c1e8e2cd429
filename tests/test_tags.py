"""Printed sheets are read back by the detector, at the millimetre where they say the tags are."""

import json
import re
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from scene import sheet, tags
from scene.frame.apriltag import TagLayout, detect

ROOT = Path(__file__).parents[1]
OFFICIAL = Path(__file__).parents[2] / "shared" / "data" / "tags"


def printed(page, dpi=100):
    """The sheet as a printer of ``dpi`` puts it on paper: (H, W, 3) uint8."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = sheet.draw(page)
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])


def command(*arguments, cwd):
    return subprocess.run([sys.executable, "-m", "scene.tags", *arguments], capture_output=True, text=True, cwd=cwd, env={"PYTHONPATH": str(ROOT)})


# The drawing


@pytest.mark.parametrize(("ids", "size", "paper"), [(range(4), 75, "a4"), ([7, 586, 100], 40, "letter"), ([5], 152, "a4"), (range(40, 60), 25, "a4")])
def test_the_detector_reads_every_tag_where_the_layout_puts_its_corners(ids, size, paper):
    sheets = sheet.pages(list(ids), size, paper)
    read = {}
    for i, page in enumerate(sheets):
        picture = printed(page, 150)
        mm = {n: corners * 25.4 / 150 for n, corners in detect(picture).items()}
        for n, corners in mm.items():
            read[n] = np.stack([corners[:, 0] + i * page.paper[0], picture.shape[0] * 25.4 / 150 - corners[:, 1]], axis=1)
    assert sorted(read) == sorted(ids)
    for n, corners in sheet.layout(sheets).corners().items():
        assert np.abs(read[n] - 1000 * corners[:, :2]).max() < 0.25, n


@pytest.mark.skipif(not OFFICIAL.exists(), reason="no official tag pictures here")
@pytest.mark.parametrize("number", range(8))
def test_a_tag_is_drawn_as_its_official_picture(number):
    official = np.array(Image.open(OFFICIAL / f"tag36_11_{number:05d}.png").convert("L")) < 128
    assert np.array_equal(np.pad(sheet.cells(number), 1), official)
    page = sheet.Page((100.0, 100.0), 80.0, {number: (50.0, 50.0)})
    picture = printed(page, 254)[..., 0] < 128  # 10 pixels a millimetre, 100 a cell
    assert np.array_equal(picture[50:1000:100, 50:1000:100][1:-1, 1:-1], official[1:-1, 1:-1])


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 60), st.floats(10, 150), st.sampled_from(sorted(sheet.PAPERS)))
def test_tags_lie_on_the_paper_and_not_on_each_other_or_the_ruler(count, size, paper):
    sheets = sheet.pages(list(range(count)), size, paper)
    assert [n for page in sheets for n in page.centres] == list(range(count))
    for page in sheets:
        centres = np.array(list(page.centres.values()))
        half = 0.625 * size
        assert (centres - half >= [sheet.MARGIN - 1e-6, sheet.MARGIN + sheet.FOOT + sheet.LABEL - 1e-6]).all()
        assert (centres + half <= np.array(page.paper) - sheet.MARGIN + 1e-6).all()
        apart = np.abs(centres[:, None] - centres).max(axis=-1)[np.triu_indices(len(centres), k=1)]
        assert (apart >= 2 * half - 1e-6).all()


def test_the_ruler_is_a_hundred_millimetres_long():
    page = sheet.pages([0], 50)[0]
    lines = [np.array(line.get_xydata()) for line in sheet.draw(page).axes[0].lines]
    level = [line for line in lines if len(line) == 2 and line[0, 1] == line[1, 1]]
    assert max(np.ptp(line[:, 0]) for line in level) == 100
    picture = printed(page, 254)[::-1, :, 0] < 128
    row = picture[int(10 * (sheet.MARGIN + 5))]
    assert np.ptp(np.nonzero(row)[0]) == pytest.approx(1000, abs=6)


@pytest.mark.parametrize(("ids", "size", "paper", "message"), [
    ([], 50, "a4", "no tag"), ([587], 50, "a4", "no tag 587"), ([3, 3], 50, "a4", "twice"), ([0], 50, "a5", "a4, letter"),
    ([0], 200, "a4", "from 10 to 152"), ([0], 5, "a4", "from 10"), ([0], float("nan"), "a4", "from 10"),
])  # fmt: skip
def test_what_cannot_be_printed_is_refused(ids, size, paper, message):
    with pytest.raises(ValueError, match=message):
        sheet.pages(ids, size, paper)


# The command


def test_the_pdf_has_the_papers_true_size_and_a_page_for_each_sheet(tmp_path):
    result = command("--ids", "0-5", "--size", "75", "--layout", "tags.json", cwd=tmp_path)
    assert result.returncode == 0 and "2 pages" in result.stdout, result.stderr
    data = (tmp_path / "tags.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", data)
    assert len(boxes) == 2
    assert np.allclose([[float(x) for x in box] for box in boxes], np.array([210, 297]) / 25.4 * 72, atol=0.01)
    layout = TagLayout.load(tmp_path / "tags.json")
    assert layout.ids == (0, 1, 2, 3, 4, 5) and layout.size == 0.075


def test_the_black_squares_are_paths_of_their_true_size_in_the_pdf(tmp_path):
    sheet.save(tmp_path / "one.pdf", sheet.pages([3], 64.0))
    streams = re.findall(rb"stream\r?\n(.*?)endstream", (tmp_path / "one.pdf").read_bytes(), re.S)
    texts = [zlib.decompress(s) for s in streams if s[:1] == b"x"]
    drawing = max((t for t in texts if b" m\n" in t), key=len).decode("latin1")
    shapes = [shape for shape in re.split(r"\n(?:f\*?|S|B|n)\n", drawing) if shape.count(" m\n") > 20]
    corners = np.array([[float(x) for x in pair] for shape in shapes for pair in re.findall(r"([-\d.]+) ([-\d.]+) [ml]\n", shape)])
    assert np.ptp(corners, axis=0) / 72 * 25.4 == pytest.approx([64, 64], abs=1e-3)


def test_the_same_command_writes_the_same_bytes(tmp_path):
    for name in ("a.pdf", "b.pdf"):
        assert tags.main(["--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_the_layout_of_the_uncut_sheet_is_a_valid_template(tmp_path):
    assert tags.main(["--ids", "0-30", "--size", "30", "--out", str(tmp_path / "t.pdf"), "--layout", str(tmp_path / "tags.json")]) == 0
    content = json.loads((tmp_path / "tags.json").read_text())
    assert content["family"] == "36h11" and len(content["tags"]) == 31
    assert TagLayout.load(tmp_path / "tags.json").size == 0.03


@pytest.mark.parametrize(("arguments", "word"), [
    (["--ids", "3-1"], "no tag"), (["--ids", "x"], "0-7,12"), (["--ids", "0,0"], "twice"), (["--size", "wide"], "millimetres"),
    (["--size", "900"], "152"), (["--paper", "a0"], "a4"), (["--colour"], "--help"), (["--size"], "argument"),
])  # fmt: skip
def test_bad_input_gets_one_line_and_writes_nothing(tmp_path, capsys, arguments, word, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert tags.main(arguments) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and said[0].startswith("error: ") and word in said[0], said
    assert not list(tmp_path.iterdir())


def test_numbers_and_ranges():
    assert tags.numbers("0-3, 7,12-12") == [0, 1, 2, 3, 7, 12]


def test_help_loads_nothing_heavy(tmp_path):
    code = "import sys\nfrom scene import tags\ntry: tags.main(['--help'])\nexcept SystemExit: print([m for m in ('numpy', 'cv2', 'matplotlib') if m in sys.modules])"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT).stdout
    assert "--layout" in printed and printed.splitlines()[-1] == "[]"
