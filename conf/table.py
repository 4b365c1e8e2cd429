"""What a sweep found: python -m conf.table runs/table1/<time> writes table.md, results.csv, plots and report.html there.

Of several folders one table is made, in the first. --keep NAME also keeps its figures in docs/results/NAME.json and puts its short form where the
README has <!-- NAME -->.
"""

import argparse
import sys
from pathlib import Path

from conf import gallery, short
from conf.results import collect


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m conf.table", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="a sweep's folder, or a job's")
    parser.add_argument("--keep", metavar="NAME")
    asked = parser.parse_args(arguments)
    try:
        results = collect(asked.folders)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(gallery.table_of(results))
    print(gallery.write(results, asked.folders[0].resolve()))
    if asked.keep:
        short.keep(results, Path("docs", "results", f"{asked.keep}.json"))
        print(short.markdown(results))
        if not short.write_readme(Path("README.md"), asked.keep, short.markdown(results)):
            print(f"README.md has no place <!-- {asked.keep} -->")
    return 0


if __name__ == "__main__":
    sys.exit(main())
