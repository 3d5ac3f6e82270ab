"""Print the way of one recipe from its file to its bundle: the modules whose functions are given it, in order.

    python scripts/trace_row.py [quickstart] [--set PATH=VALUE ...] [--all]

Each function counts once, at its first call with a recipe, a row of the plan or a sensor's model among its arguments
(--all: any function). A stay is a run of such calls in one module; a return is a stay in a module that was left before.
"""

import argparse
import sys
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType

from tacgen.batch import pipeline
from tacgen.recipe import assets, plan

PACKAGE = Path(plan.__file__).parents[1]
HANDED_ON = {"Loaded", "Recipe", "Row", "Sensor", "LitSensor", "Plan"}  # classes


def stays(recipe: str, sets: list[str], *, every: bool) -> list[str]:
    """Modules in the order of their stays."""
    seen: set[CodeType] = set()
    modules: list[str] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or code in seen or not code.co_filename.startswith(str(PACKAGE)):
            return
        given = (frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])
        if every or any(type(value).__name__ in HANDED_ON for value in given):
            seen.add(code)
            modules.append(".".join(Path(code.co_filename).relative_to(PACKAGE).with_suffix("").parts))

    with TemporaryDirectory() as folder:
        sys.setprofile(note)
        try:
            pipeline.run(plan.load(assets.recipe_path(recipe), sets).rows, Path(folder))
        finally:
            sys.setprofile(None)
    return [module for module, _ in groupby(modules)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe", nargs="?", default="quickstart", help="name or file")
    parser.add_argument("--set", action="append", default=["quality=draft", "vary=null"], dest="sets")
    parser.add_argument("--all", action="store_true", help="functions with any arguments")
    asked = parser.parse_args()
    way = stays(asked.recipe, asked.sets, every=asked.all)
    left: set[str] = set()
    for before, module in zip([None, *way], way, strict=False):
        left |= {before} if before else set()
        print(f"{'  back to ' if module in left else ''}{module}")
    rooms = len(set(way))
    print(f"{rooms} modules, {len(way)} stays, {len(way) - rooms} returns")


if __name__ == "__main__":
    main()
