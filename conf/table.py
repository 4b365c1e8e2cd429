"""What a sweep found: python -m conf.table runs/table1/<time> writes table.md, results.csv, plots and report.html there.

Of several folders one table is made, in the first.
"""

import argparse
import sys
from pathlib import Path

from conf import gallery
from conf.results import collect, markdown


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m conf.table", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="a sweep's folder, or a job's")
    folders = parser.parse_args(arguments).folders
    try:
        results = collect(folders)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(markdown(results))
    print(gallery.write(results, folders[0]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
