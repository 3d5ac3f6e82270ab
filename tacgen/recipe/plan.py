"""Recipe -> Plan: the table of resolved scenes; here and in sampling alone numbers are drawn.

Numbers come from SeedSequence((seed, scene, purpose)), never from the order of work: row i drawn alone equals
row i of the whole plan.
"""

import hashlib
import json
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

from tacgen.base.errors import UserError
from tacgen.outputs import IMAGE_OUTPUTS
from tacgen.recipe import checks, loading, sensor_base, sensor_checks, usual_sizes
from tacgen.recipe.loading import SOLID_FILE_KEY, Loaded, folders
from tacgen.recipe.model import Distribution, Recipe, Vary
from tacgen.recipe.row import Row, resolved, scene_seed
from tacgen.recipe.sampling import correlated, draw, inner_spreads, scene_count
from tacgen.sensor import usual_values
from tacgen.sensor.model import Sensor
from tacgen.sensor.usual_values import unusual
from tacgen.sensor.validation_messages import Issue, report, validate
from tacgen.sensor.yaml_source import KeyPath, Tree, at, format_path, is_within, parents_first, parse_path

UNVARIED_KEYS = ("tacgen", "name", "sensor_overrides", "extends", "vary")  # cannot be varied
MAX_SCENES = 1_000_000
OnSensor = tuple[Sensor, dict[KeyPath, Path]]  # a sensor, and where the path of its gel's solid starts


class Rows(Sequence[Row]):
    """Scenes that are resolved each time they are asked for: of a million, only the drawn numbers are held."""

    def __init__(self, resolve: Callable[[int], Row], places: range) -> None:
        self._resolve, self._places = resolve, places

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> "Rows": ...
    def __getitem__(self, at: int | slice) -> "Row | Rows":
        return Rows(self._resolve, self._places[at]) if isinstance(at, slice) else self._resolve(self._places[at])

    def __iter__(self) -> Iterator[Row]:
        return map(self._resolve, self._places)


@dataclass(frozen=True)
class Plan:
    """All scenes of a recipe, in order."""

    name: str
    rows: Sequence[Row]
    frames: Sequence[int]  # of each scene
    paths: tuple[str, ...] = ()  # what is varied
    warnings: tuple[str, ...] = ()  # what a person should know before this is run
    sensors: tuple[str, ...] = ()  # names of those that its scenes are made on, in the order of the recipe
    inputs: str = ""  # SHA-256 of recipe and sensor, the same for all shards


def load(
    source: Path | Tree, sets: Iterable[str] = (), shard: tuple[int, int] = (0, 1), sensor: Sensor | None = None
) -> Plan:
    """Read a recipe and expand it, or shard i of N: the scenes whose index leaves i when divided by N.

    `source`, `sets` and `sensor` are those of loading.read.

    Raises UserError: every problem of recipe, sensor and varied scenes.
    """
    loaded = loading.read(source, sets, sensor)
    count = scene_count(loaded.recipe.vary) if loaded.recipe.vary else 1
    known = [loaded.recipe.document(), loaded.sensor.model_dump(mode="json")]
    inputs = hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
    return replace(expand(loaded, range(shard[0], count, shard[1])), inputs=inputs)


def expand(loaded: Loaded, indices: Sequence[int] | None = None) -> Plan:
    """The scenes of a recipe: all, or those of some indices, each as in the whole plan.

    Raises:
        UserError: a varied value makes a scene invalid; the lines name scene and path.
    """
    recipe, sensor, tree, vary = loaded.recipe, loaded.sensor, loaded.tree, loaded.recipe.vary
    told = usual_values.warnings(sensor, loaded.sensor_tree) if loaded.sensor_tree else ()
    if vary is None:
        told += tuple(odd.place(tree) for odd in usual_sizes.unusual(recipe, sensor.gel))
        other, starts = loaded.other, loaded.starts
        if other is not None and other is not sensor:
            told += tuple(f"{other.name}: {format_path(odd.path)}: {odd.message}" for odd in unusual(other.gel))
        seed = scene_seed(0, 0)
        only = Row(0, "scene-00000", seed, resolved(recipe, starts), sensor, folders=starts, other=other)
        times = 1 if indices is None else len(indices)
        names = tuple(dict.fromkeys(each.name for each in (sensor, other) if each))
        return Plan(recipe.name, times * [only], times * [only.frames], warnings=told, sensors=names)
    _check(vary, tree)
    count = scene_count(vary)
    wanted = range(count) if indices is None else indices
    base = recipe.model_copy(update={"vary": None, "sensors": None}).document()
    named, more = _named(vary, tree, bool(recipe.outputs & IMAGE_OUTPUTS))
    known = sensor, loading.solid_start(sensor, loaded.sensor_tree)
    drawn = draw(vary, wanted)

    def attempt(k: int, *, checking: bool) -> tuple[Row | None, list[Issue]]:
        values = drawn(k)
        chosen = named[values["sensor"]] if "sensor" in values else known
        return _resolve(wanted[k], values, base, chosen, loaded, checking=checking)

    def resolve(k: int) -> Row:
        row, _ = attempt(k, checking=False)
        assert row is not None, "it was checked"
        return row

    frames = array("i")
    problems: dict[tuple[KeyPath, str], list[tuple[str, Issue]]] = {}
    odd: dict[KeyPath, list[tuple[str, Issue]]] = {}  # unusual values of the recipe, and of a gel that is drawn
    drawn_gel = any(name.startswith("sensor.gel") for name in vary.paths)
    for k, index in enumerate(wanted):
        row, wrong = attempt(k, checking=True)
        frames.append(row.frames if row else 0)
        drawn_gels = unusual(row.sensor.gel) if row and drawn_gel else ()
        of_gel = [replace(strange, path=("sensor", *strange.path)) for strange in drawn_gels]
        for strange in (*of_gel, *(usual_sizes.unusual(row.recipe, row.sensor.gel) if row else ())):
            odd.setdefault(strange.path, []).append((f"scene-{index:05d}", strange))
        for problem in wrong:
            alike = re.sub(r"-?\d[\d.e+-]*", "#", problem.message)  # numbers differ from scene to scene
            problems.setdefault((problem.path, alike), []).append((f"scene-{index:05d}", problem))
    if problems:
        raise UserError(_message(group, tree, vary) for group in problems.values())
    names = tuple(dict.fromkeys(each.name for each, _ in named.values())) or (sensor.name,)
    told += tuple(_message(group, tree, vary).split("\n", 1)[0] for group in odd.values())
    told = tuple(dict.fromkeys((*told, *more))) + tuple(problem.point(tree) for problem in correlated(vary))
    varied = Rows(resolve, range(len(wanted)))
    return Plan(recipe.name, varied, frames, tuple(vary.paths), told, names)


def _check(vary: Vary, tree: Tree) -> None:
    """Raise UserError for what cannot be varied, or not by this method."""
    problems: list[Issue] = []
    known: dict[KeyPath, str] = {}
    for name, here in vary.paths.items():
        spread, gridded = getattr(vary, str(here[1]))[name], "grid" in (vary.method, here[1])
        try:
            path = parse_path(name)
        except ValueError as error:
            problems.append(Issue(here, str(error), at_key=True))
            continue
        if (same := known.setdefault(path, name)) != name:
            problems.append(Issue(here, f"is {same}, which is varied already: leave one of them out", at_key=True))
        if path[0] in UNVARIED_KEYS:
            problems.append(Issue(here, f"{path[0]} cannot be varied: write a recipe for each value", at_key=True))
        if path == ("sensor",) and not all(isinstance(value, str) for value in spread.choice or (None,)):
            problems.append(Issue(here, "must be a choice of sensors' names or files"))
        for inner, found in inner_spreads(spread.choice):
            where = (*here, "choice", *inner)
            if gridded:
                text = "a grid takes no distribution inside a choice: draw over samples, or write out the choices"
                problems.append(Issue(where, text))
            elif "choice" in found and next(inner_spreads(found["choice"]), None):
                problems.append(Issue(where, "holds a distribution inside a choice inside a choice: one is enough"))
            problems += [replace(odd, path=(*where, *odd.path)) for odd in validate(Distribution, found)[1]]
        if here[1] == "grid" and name in vary.over:
            problems.append(Issue(here, "is in over already: leave one of them out", at_key=True))
        if gridded and spread.choice is None and spread.linspace is None:
            problems.append(Issue(here, "a grid takes choice or linspace only"))
    if not problems and scene_count(vary) > MAX_SCENES:
        text = f"gives {scene_count(vary)} scenes; at most {MAX_SCENES} can be: fewer samples or choices"
        problems.append(Issue(("vary", "over"), text))
    if problems:
        raise UserError(problem.point(tree) for problem in problems)


def _named(vary: Vary, tree: Tree, images: bool) -> tuple[dict[str, OnSensor], tuple[str, ...]]:
    """The sensors that a `vary` names, the recipe's overrides laid over each; and warnings about them.

    Raises UserError: every problem of all of them.
    """
    sensors, problems = dict[str, OnSensor](), []
    told: tuple[str, ...] = ()
    if where := vary.paths.get("sensor"):
        for name in getattr(vary, str(where[1]))["sensor"].choice:
            chosen = tree.replaced(("sensor",), Tree(name, {(): tree.spot(where)}))
            sensor, sensor_tree, wrong = loading.named_sensor(chosen, images)
            problems += wrong
            if sensor is not None:
                sensors[name] = sensor, loading.solid_start(sensor, sensor_tree)
                told += usual_values.warnings(sensor, sensor_tree)
    if problems:
        raise report(problems)
    return sensors, told


def _resolve(
    index: int, values: dict[str, Any], base: dict[str, Any], chosen: OnSensor, loaded: Loaded, *, checking: bool
) -> tuple[Row | None, list[Issue]]:
    """One row, `checking` it as if a person had written it; or what is wrong with it."""
    (sensor, solid), tree, vary, sensors = chosen, loaded.tree, loaded.recipe.vary, loaded.recipe.sensors
    assert vary is not None
    data, plain_sensor, wrong = _laid_over(base, sensor, values)
    if wrong:
        return None, wrong
    recipe, wrong = validate(Recipe, data)
    if plain_sensor is not None:
        if (name := f"sensor.{format_path(SOLID_FILE_KEY)}") in values:
            solid = {("sensor", *SOLID_FILE_KEY): (tree.spot(vary.paths[name]).value.source.folder or Path()).resolve()}
        images = recipe is not None and bool(recipe.outputs & IMAGE_OUTPUTS)
        folder = solid.get(("sensor", *SOLID_FILE_KEY))
        varied, more = sensor_checks.check(plain_sensor, folder, images) if checking else validate(Sensor, plain_sensor)
        wrong += [Issue(("sensor", *problem.path), problem.message, problem.at_key) for problem in more]
        if varied is None:
            return None, wrong
        sensor = sensor_base.marked(varied)
    if recipe is None:
        return None, wrong
    starts = {**folders(tree, recipe, vary.paths), **solid}
    wrong += checks.recipe_problems(recipe, sensor, starts) if checking else []
    tree = tree.replaced(("sensor_overrides",), Tree(data["sensor_overrides"])) if plain_sensor is not None else tree
    other, lacking = loading.right_sensor(recipe, sensor, tree)
    wrong += [problem for problem, _ in lacking]
    if wrong:
        return None, wrong
    seed, complete = scene_seed(vary.seed, index), resolved(recipe, starts)
    pair = index // len(sensors) if sensors else None
    return Row(index, f"scene-{index:05d}", seed, complete, sensor, values, starts, other, pair=pair), []


def _laid_over(base: Any, sensor: Sensor, values: dict[str, Any]) -> tuple[Any, Any, list[Issue]]:
    """A recipe's plain values with the varied ones in them; those of its sensor, None where it is not varied; and what
    has no place there.

    Parents are laid before what lies in them, whatever their order; mappings of the sensor are merged, as those of
    `sensor_overrides` are.
    """
    names = [name for name in parents_first(values) if name != "sensor"]
    inside = [name for name in names if name.startswith("sensor.")]
    laid = Tree({**base, "sensor": sensor.model_dump(mode="json", exclude_none=True) if inside else None})
    for name in names:
        path, value = parse_path(name), Tree(values[name])
        parents = [up for up in names if up != name and is_within(path, parse_path(up))]
        if parents and at(laid.data, path[:-1]) is None:
            text = f"has no place in the {parents[-1]} that is drawn: write its values into the choices instead"
            return None, None, [Issue(path, text)]
        try:
            laid = laid.merged(value, path) if name in inside else laid.replaced(path, value)
        except LookupError as error:
            return None, None, [Issue(path, str(error))]
    overrides, plain = dict(base["sensor_overrides"]), laid.data["sensor"]
    for key in base["sensor_overrides"]:
        if any(is_within(("sensor", *parse_path(key)), parse_path(name)) for name in inside):
            overrides[key] = at(plain, parse_path(key))  # what a varied parent has made of it
    overrides |= {name.removeprefix("sensor."): values[name] for name in inside}
    named = values.get("sensor", base["sensor"])
    return {**laid.data, "sensor": named, "sensor_overrides": overrides}, plain, []


def _message(group: list[tuple[str, Issue]], tree: Tree, vary: Vary) -> str:
    """One line for all scenes that fail alike, pointing at the varied path to blame when there is one."""
    scene, problem = group[0]
    more = f" (and {len(group) - 1} more scenes)" if len(group) > 1 else ""
    paths = {name: parse_path(name) for name in vary.paths}
    near = [name for name, p in paths.items() if is_within(problem.path, p) or is_within(p, problem.path)]
    nearest = max(near, key=lambda name: min(len(paths[name]), len(problem.path)), default=None)
    blame = problem.path if nearest is None else vary.paths[nearest]
    text = f"{scene}: {format_path(problem.path)}: {problem.message}{more}"
    return Issue(blame, text, at_key=True).mark(tree).point(text)
