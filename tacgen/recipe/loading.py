"""Read a recipe file with the recipe it extends, `--set` and its sensor file; give a checked Recipe and Sensor."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tacgen.base.errors import UserError
from tacgen.outputs import IMAGE_OUTPUTS
from tacgen.recipe import assets, checks, grasp_checks, sensor_checks
from tacgen.recipe.model import Recipe
from tacgen.sensor.model import Sensor
from tacgen.sensor.validation_messages import Issue, report, suggest, validate
from tacgen.sensor.yaml_source import (
    KeyPath,
    Mark,
    Source,
    Spot,
    Tree,
    at,
    describe,
    is_within,
    load,
    parents_first,
    parse,
    parse_path,
)

SOLID_FILE_KEY: KeyPath = ("gel", "solid", "file")


@dataclass(frozen=True)
class Loaded:
    """A checked recipe and its sensor, with the trees that hold the position of each value."""

    recipe: Recipe
    sensor: Sensor
    tree: Tree  # of the recipe, `extends` and `--set` merged in
    sensor_tree: Tree | None  # of the sensor, overrides merged in; None: it is in no file
    starts: dict[KeyPath, Path]  # where the paths of their files start
    other: Sensor | None  # of a grasp the right finger's


def read(source: Path | Tree, sets: Iterable[str] = (), sensor: Sensor | None = None) -> Loaded:
    """Read a recipe and its sensor. Raises UserError with every problem of both files at once.

    Args:
        source: the recipe file, or the tree of a recipe that is in no file.
        sets: overrides as on the command line, `indenter.radius_mm=3`; `sensor.` reaches into the sensor.
        sensor: instead of the sensor that the recipe names.
    """
    tree = _crossed(merged(source, sets))
    recipe, wrong = validate(Recipe, tree.data)
    problems = [(problem, tree) for problem in wrong]
    images = recipe is not None and bool(recipe.outputs & IMAGE_OUTPUTS)
    try:
        if sensor is None:
            sensor, sensor_tree, more = named_sensor(tree, images)
        else:
            plain = Tree(sensor.model_dump(mode="json", exclude_none=True))
            sensor, sensor_tree, more = _overridden_sensor(plain, tree, images)
    except UserError as error:  # the sensor file is not YAML: report it with the problems of the recipe
        raise UserError([*report(problems).lines, *error.lines]) from None
    problems += more
    if recipe is None or sensor is None:
        raise report(problems)
    return _checked(recipe, sensor, tree, sensor_tree, problems)


def merged(source: Path | Tree, sets: Iterable[str] = ()) -> Tree:
    """The tree of a recipe, merged over the one it extends and with its overrides; arguments as of `read`."""
    tree = _extended(source, ())
    for text in sets:
        tree = _set(tree, text)
    return tree


def checked(recipe: Recipe, sensor: Sensor) -> Loaded:
    """A recipe and a sensor that were made in Python. Raises UserError: the recipe asks for what the sensor cannot."""
    return _checked(recipe, sensor, Tree(recipe.document()), None, [])


def _checked(
    recipe: Recipe, sensor: Sensor, tree: Tree, sensor_tree: Tree | None, problems: list[tuple[Issue, Tree]]
) -> Loaded:
    """Both, checked together. Raises UserError: there are `problems`, or more are found."""
    other, more = right_sensor(recipe, sensor, tree)
    starts = solid_start(sensor, sensor_tree) | folders(tree, recipe)
    more += [(problem, tree) for problem in checks.recipe_problems(recipe, sensor, starts)]
    if problems or more:
        raise report([*problems, *more])
    return Loaded(recipe, sensor, tree, sensor_tree, starts, other)


def _crossed(tree: Tree) -> Tree:
    """A tree with several `sensors`: the first becomes `sensor`, and `vary` takes each scene on all of them.

    They vary fastest, so that the scenes of one contact follow each other.
    """
    names, vary = tree.data.get("sensors"), tree.data.get("vary")
    if not isinstance(names, list) or not names or not isinstance(vary, dict | None):
        return tree  # the recipe's own check reports it
    choice = Tree({}, {(): tree.spot(("sensors",))}).replaced(("choice",), tree.under(("sensors",)))
    tree = tree.replaced(("sensor",), tree.under(("sensors", 0)))
    if vary is None:
        tree = tree.replaced(("vary",), Tree({"method": "grid", "over": {}}))
    key = "grid" if vary else "over"
    if "sensor" in (at(vary, (key,)) or {}):
        text = "cannot be given beside sensors, which are varied already: leave it out"
        raise report([(Issue(("vary", key, "sensor"), text, at_key=True), tree)])
    return tree.replaced(("vary", key, "sensor"), choice)


def read_sensor(path: Path) -> tuple[Sensor, Tree]:
    """Read and check a sensor file alone. Raises UserError with all problems."""
    tree = load(path)
    sensor, wrong = sensor_checks.check(tree.data, solid_folder(tree))
    if wrong or sensor is None:
        raise report((problem, tree) for problem in wrong)
    return sensor, tree


def folders(tree: Tree, recipe: Recipe, varied: Mapping[str, KeyPath] | None = None) -> dict[KeyPath, Path]:
    """The folder to which the path of each file of a recipe is relative: that of the file in which it is written.

    `varied`: the paths of `vary`, one of which may name the file instead, and their places in the recipe.
    """
    starts: dict[KeyPath, Path] = {}
    for path in recipe.files:
        above = [name for name in parents_first(varied or {}) if is_within(path, parse_path(name))]
        where = (varied or {})[above[-1]] if above else path
        starts[path] = (tree.spot(where).value.source.folder or Path()).resolve()
    return starts


def solid_folder(sensor_tree: Tree) -> Path:
    """The folder to which the path of a gel's solid is relative: that of the file in which it is written."""
    return (sensor_tree.spot(SOLID_FILE_KEY).value.source.folder or Path()).resolve()


def right_sensor(recipe: Recipe, sensor: Sensor, tree: Tree) -> tuple[Sensor | None, list[tuple[Issue, Tree]]]:
    """The sensor of a grasp's right finger, the recipe's overrides laid over it, or what is wrong with it; None where
    there is no grasp."""
    if recipe.grasp is None:
        return None, []
    if recipe.grasp.right is None:
        return sensor, []
    chosen = Tree(recipe.grasp.right, {(): tree.spot(("grasp", "right"))})
    other, _, wrong = named_sensor(tree.replaced(("sensor",), chosen), bool(recipe.outputs & IMAGE_OUTPUTS))
    named = [problem for problem, _ in wrong if problem.path == ("sensor",)]  # it is not there
    wrong = [(problem, where) for problem, where in wrong if problem not in named]
    if other is not None:
        named += [*grasp_checks.solid(other), *checks.output_problems(recipe, other)]
    return other, wrong + [(replace(problem, path=("grasp", "right")), tree) for problem in named]


def solid_start(sensor: Sensor, sensor_tree: Tree | None) -> dict[KeyPath, Path]:
    """Where the path of a gel's solid starts, if it has one."""
    if sensor.gel.solid is None or sensor_tree is None:
        return {}
    return {("sensor", *SOLID_FILE_KEY): solid_folder(sensor_tree)}


def _extended(source: Path | Tree, chain: tuple[Path, ...]) -> Tree:
    """The tree of a recipe merged over the one it extends. `chain` holds the files that extend it."""
    tree = source if isinstance(source, Tree) else load(source)
    path = None if isinstance(source, Tree) else source

    def refused(text: str, *place: str) -> UserError:
        return report([(Issue(place, text), tree)])

    if not isinstance(tree.data, dict):
        raise refused(f"a recipe must be a mapping (got {describe(tree.data)})")
    if "tacgen_sensor" in tree.data:
        name = "my_sensor.yaml" if path is None else path.name
        raise refused(f"is a sensor file, not a recipe: a recipe names it, as in sensor: {name}")
    if "extends" not in tree.data:
        return tree
    name, here = tree.data["extends"], chain if path is None else (*chain, path.resolve())
    if not isinstance(name, str) or not name:
        told = f"must be the path of a recipe, or the name of a shipped one (got {describe(name)})"
        raise refused(told, "extends")
    try:
        other = assets.recipe_path(name, None if path is None else path.parent)
    except UserError as error:
        raise refused(error.lines[0], "extends") from None
    if other.resolve() in here:
        raise refused(f"{name} is extended by this very recipe: extend another", "extends")
    return _extended(other, here).merged(tree.without("extends"))


def _set(tree: Tree, text: str) -> Tree:
    """A tree changed by `a.b[0].c=value`; the value is YAML."""
    source = Source(f"--set {text}")
    path_text, equals, value_text = text.partition("=")
    if not equals:
        raise UserError(f"--set {text}: needs the form path=value, such as indenter.radius_mm=3")
    try:
        path = parse_path(path_text.strip())
        value = parse(value_text, source)
        value = Tree(value.data, {path: Spot(Mark(source), Mark(source)) for path in value.spots})  # no line, no column
        if path[0] == "extends":
            raise LookupError("extends can only stand in the recipe")
        if path[0] == "sensor" and len(path) > 1:
            key = path_text.strip().removeprefix("sensor").lstrip(".")
            return tree.replaced(("sensor_overrides", key), value)
        if path[0] in Sensor.model_fields and path[0] not in Recipe.model_fields:
            raise LookupError(f"{path[0]} is a key of the sensor, did you mean sensor.{path_text.strip()}?")
        return tree.replaced(path, value)
    except (ValueError, LookupError) as error:
        raise UserError(f"--set {text}: {error}") from None


def named_sensor(tree: Tree, images: bool) -> tuple[Sensor | None, Tree, list[tuple[Issue, Tree]]]:
    """The sensor that a recipe names, with its overrides; each problem comes with the tree it belongs to."""
    name, nothing = tree.data.get("sensor"), Tree(None)
    if not isinstance(name, str) or not name:
        return None, nothing, []  # the recipe's own check reports it
    try:
        sensor_path = assets.sensor_path(name, tree.spot(("sensor",)).value.source.folder)
    except UserError as error:
        return None, nothing, [(Issue(("sensor",), error.lines[0]), tree)]
    return _overridden_sensor(load(sensor_path), tree, images)


def _overridden_sensor(
    sensor_tree: Tree, tree: Tree, images: bool
) -> tuple[Sensor | None, Tree, list[tuple[Issue, Tree]]]:
    """A sensor with the recipe's overrides laid over it; each problem comes with the tree it belongs to."""
    if not isinstance(sensor_tree.data, dict):
        wrong = Issue((), f"a sensor must be a mapping (got {describe(sensor_tree.data)})")
        return None, Tree(None), [(wrong, sensor_tree)]
    overrides, lost = tree.data.get("sensor_overrides"), list[tuple[Issue, Tree]]()
    for key in parents_first(overrides) if isinstance(overrides, dict) else ():  # paths; mappings are merged
        here: KeyPath = ("sensor_overrides", key)
        try:
            sensor_tree = sensor_tree.merged(tree.under(here), parse_path(key))
        except (ValueError, LookupError) as error:
            hint = suggest(key, sensor_tree.data) if "." not in key else ""
            lost.append((Issue(here, f"{error}{hint}", at_key=True), tree))
    sensor, of_sensor = sensor_checks.check(sensor_tree.data, solid_folder(sensor_tree), images)
    return sensor, sensor_tree, lost + [(problem, sensor_tree) for problem in of_sensor]
