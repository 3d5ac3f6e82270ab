"""Print hashes of the bundles of recipes, to compare two versions of tacgen with diff.

    python scripts/digests.py [quickstart tap ...] [-o folder] [--set PATH=VALUE ...] > after.txt

Without names, all shipped recipes; each as one scene at draft quality. A line is `sha256  recipe  file`; equal lines
mean equal bytes. Compare on one machine with the same number of threads: the order of sums changes their rounding.
"""

import argparse
import hashlib
from pathlib import Path
from tempfile import TemporaryDirectory

from tacgen import pipeline
from tacgen.recipe import assets, plan


def digests(recipe: str, folder: Path, sets: list[str]) -> list[str]:
    """A line for each bundle of a recipe given by name or path; bundles of earlier runs are made again."""
    rows = plan.load(assets.recipe_path(recipe), ["quality=draft", "vary=null", *sets]).rows
    place = folder / Path(recipe).stem
    for old in place.glob("scene-*.h5"):
        old.unlink()
    made = pipeline.run(rows, place)
    return [f"{hashlib.sha256(m.path.read_bytes()).hexdigest()}  {recipe}  {m.path.name}" for m in made]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipes", nargs="*", help="names or files; all shipped recipes if left out")
    parser.add_argument("-o", "--out", type=Path, help="keep the bundles in this folder")
    parser.add_argument("--set", action="append", default=[], dest="sets", metavar="PATH=VALUE")
    given = parser.parse_args()
    with TemporaryDirectory() as spare:
        for recipe in sorted(given.recipes or assets.list_recipes()):
            print(*digests(recipe, given.out or Path(spare), given.sets), sep="\n", flush=True)


if __name__ == "__main__":
    main()
