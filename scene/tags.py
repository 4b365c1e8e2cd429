"""AprilTags to print, and the layout that says where they are.

    python -m scene.tags                                    tags 0 to 3 of 75 mm on A4 -> tags.pdf
    python -m scene.tags --ids 0-7,12 --size 50 --paper letter --layout tags.json
"""

import argparse
import sys


def main(arguments: list[str] | None = None) -> int:
    """Write the sheets; the exit code is 2, after one line, where the input was at fault."""
    parser = argparse.ArgumentParser(
        "scene.tags", description=__doc__, epilog="Part of scene2skill. Tags are of the family 36h11.",
        formatter_class=argparse.RawDescriptionHelpFormatter, exit_on_error=False,
    )  # fmt: skip
    parser.add_argument("--ids", default="0-3", help="numbers and ranges, as 0-7,12 (default: 0-3)")
    parser.add_argument("--size", default="75", help="edge of the black square [mm] (default: 75)")
    parser.add_argument("--paper", default="a4", help="a4 or letter (default: a4)")
    parser.add_argument("--out", default="tags.pdf", help="the PDF to write (default: tags.pdf)")
    parser.add_argument("--layout", help="also write this tags.json: places on the uncut sheets, to be edited")
    try:
        given, unknown = parser.parse_known_args(arguments)
        if unknown:
            raise ValueError(f"unknown {' '.join(unknown)}; --help names the options")
        _write(given)
    except (argparse.ArgumentError, ValueError, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def _write(given: argparse.Namespace):
    ids, size = numbers(given.ids), _millimetres(given.size)
    from scene import sheet

    sheets = sheet.pages(ids, size, given.paper.lower())
    sheet.save(given.out, sheets)
    many = "s" if len(sheets) > 1 else ""
    print(f"{given.out}: {len(ids)} tags of {size:g} mm on {len(sheets)} page{many}; print at 100 %, measure the ruler")
    if given.layout:
        sheet.layout(sheets).save(given.layout)
        print(f"{given.layout}: from the uncut sheet's lower left corner; put in where they are in the robot's base")


def numbers(text: str) -> list[int]:
    """"0-3,7" -> [0, 1, 2, 3, 7]."""
    found = []
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdecimal() or not (last or first).isdecimal() or int(last or first) - int(first) > 10_000:
            raise ValueError(f"--ids {text}: numbers and ranges are written as 0-7,12")
        found += range(int(first), int(last or first) + 1)
    return found


def _millimetres(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"--size {text}: the edge of the black square in millimetres is a number") from None


if __name__ == "__main__":
    sys.exit(main())
