"""Sheets of AprilTags (36h11) to print at true scale, each tag named, with a ruler that shows if the printer scaled.

A tag's picture is 10 x 10 cells: the black square of 8 x 8, whose edge is the tag's size, in a white border of one.
Marks in the border's corners show where to cut. Uncut, the whole sheet is a layout of known places (``layout``).

Notation
    x, y     [mm] from the lower left corner of the paper, x right, y up
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scene.files import replacing
from scene.frame.apriltag import FAMILY, FAMILY_SIZE, TagLayout

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
"""Width and height [mm]."""
MARGIN, LABEL, FOOT, RULER = 10.0, 6.0, 18.0, 100.0
"""What printers leave white at the edges; the line of text below a tag; the strip with the ruler; its length [mm]."""
INCH = 25.4


@dataclass(frozen=True)
class Page:
    """One sheet. paper: (width, height) [mm]; size: edge of the black squares [mm]; centres: {number: (x, y)}."""

    paper: tuple[float, float]
    size: float
    centres: dict[int, tuple[float, float]]


def pages(ids: Sequence[int], size: float, paper: str = "a4") -> list[Page]:
    """Tags ``ids`` of ``size`` [mm], row by row, on as few sheets as they need.

    ValueError for unknown papers, numbers that are not in the family or come twice, and sizes that do not fit.
    """
    if paper not in PAPERS:
        raise ValueError(f"unknown paper {paper}; there are {', '.join(PAPERS)}")
    wrong = [n for n in ids if not 0 <= n < FAMILY_SIZE]
    if wrong or not ids or len(set(ids)) < len(ids):
        said = f"no tag {wrong[0]}" if wrong else "the same tag twice" if ids else "no tag"
        raise ValueError(f"{said}: numbers of {FAMILY} go from 0 to {FAMILY_SIZE - 1}, each one once")
    width, height = PAPERS[paper]
    room = width - 2 * MARGIN, height - 2 * MARGIN - FOOT
    cell = 1.25 * size, 1.25 * size + LABEL
    largest = min(room[0], room[1] - LABEL) / 1.25
    if not 10 <= size <= largest:
        sizes = f"sizes go from 10 to {np.floor(largest):.0f} mm (edge of the black square)"
        raise ValueError(f"a tag of {size:g} mm: on {paper} {sizes}")
    columns, rows = (int(space // need) for space, need in zip(room, cell))
    gap = [(space - count * need) / (count + 1) for space, count, need in zip(room, (columns, rows), cell)]
    xs = [MARGIN + gap[0] + i * (cell[0] + gap[0]) + cell[0] / 2 for i in range(columns)]
    ys = [height - MARGIN - gap[1] - j * (cell[1] + gap[1]) - cell[0] / 2 for j in range(rows)]
    places = [(x, y) for y in ys for x in xs]
    split = [ids[k : k + len(places)] for k in range(0, len(ids), len(places))]
    return [Page((width, height), float(size), dict(zip(some, places))) for some in split]


def cells(number: int) -> np.ndarray:
    """The black square (8, 8) of a tag as the official picture shows it: True is black, row 0 the top."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return cv2.rotate(cv2.aruco.generateImageMarker(dictionary, number, 8), cv2.ROTATE_180) == 0


def draw(page: Page):
    """The sheet as a matplotlib figure of the paper's size, 1 data unit a millimetre."""
    from matplotlib.figure import Figure

    width, height = page.paper
    figure = Figure(figsize=(width / INCH, height / INCH), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
    axes.set_axis_off()
    for number, centre in page.centres.items():
        _draw_tag(axes, number, centre, page.size)
    _draw_ruler(axes, page)
    return figure


def _draw_tag(axes, number: int, centre: tuple[float, float], size: float):
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    edge, (x, y) = size / 8, np.subtract(centre, size / 2)
    rows, columns = np.nonzero(cells(number))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * edge
    squares = [Outline(corners + [x + c * edge, y + (7 - r) * edge], closed=True) for r, c in zip(rows, columns)]
    # one path: between shapes of their own, viewers draw hairlines
    axes.add_patch(PathPatch(Outline.make_compound_path(*squares), facecolor="black", linewidth=0))
    half, tick = 0.625 * size, min(2.0, edge / 3)
    for sx in (-1, 1):
        for sy in (-1, 1):
            px, py = centre[0] + sx * half, centre[1] + sy * half
            axes.plot([px, px - sx * tick], [py, py], [px, px], [py, py - sy * tick], color="0.4", linewidth=0.4)
    text = f"tag {number}   {FAMILY}   black square {size:g} mm"
    font = min(9.0, 0.055 * 1.25 * size * 72 / INCH)  # so that it is no wider than the tag
    axes.text(centre[0], centre[1] - half - 0.6, text, ha="center", va="top", fontsize=font)


def _draw_ruler(axes, page: Page):
    left, bottom = (page.paper[0] - RULER) / 2, MARGIN + 5
    axes.plot([left, left + RULER], [bottom, bottom], color="black", linewidth=0.6)
    for mm in range(0, int(RULER) + 1, 5):
        length = 4 if mm % 50 == 0 else 3 if mm % 10 == 0 else 1.5
        axes.plot([left + mm] * 2, [bottom, bottom + length], color="black", linewidth=0.6)
    said = "This line is 100 mm long; if not, print again at 100 %, without fitting to the page."
    axes.text(page.paper[0] / 2, bottom - 1.5, said, ha="center", va="top", fontsize=7)


def save(path: str | Path, sheets: Sequence[Page]):
    """Write the sheets as one PDF of their true size."""
    from matplotlib.backends.backend_pdf import PdfPages

    with replacing(path) as temporary, PdfPages(temporary, metadata={"CreationDate": None}) as pdf:
        for page in sheets:
            pdf.savefig(draw(page))


def layout(sheets: Sequence[Page]) -> TagLayout:
    """Where the tags of uncut sheets side by side are: the base at the first one's lower left corner, z up."""
    poses = {}
    for i, page in enumerate(sheets):
        for number, (x, y) in page.centres.items():
            poses[number] = np.eye(4)
            poses[number][:2, 3] = np.round([(x + i * page.paper[0]) / 1000, y / 1000], 6)
    return TagLayout(sheets[0].size / 1000, poses)
