"""pydantic's validation errors as plain sentences, with the line and column of the value in the YAML file."""

import difflib
import json
import math
import types
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from tacgen.base.errors import UserError
from tacgen.sensor.yaml_source import CHOICE_KEYS, KeyPath, Mark, Tree, at, describe, format_path, leaves

Model = TypeVar("Model", bound=BaseModel)

MISSING_MESSAGE = "is missing"
MAX_NUMBER = 1e12  # magnitude of a number: what is computed from larger ones overflows; seeds have a limit of their own
TYPE_NOUNS = {
    kind: noun
    for noun, kinds in {
        "a number": "float_type float_parsing",
        "a finite number": "finite_number",
        "a whole number": "int_type int_parsing int_from_float",
        "a smaller whole number": "int_parsing_size",
        "text": "string_type",
        "true or false": "bool_type",
        "a mapping": "model_type model_attributes_type dict_type",
        "a list": "tuple_type list_type set_type frozen_set_type",
    }.items()
    for kind in kinds.split()
}
BOUND_TEXTS = {
    "greater_than": ("greater than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}
MIN_LIKENESS = 0.65  # difflib's ratio above which one word is taken for a misspelling of another [-]
# words of other simulators and of papers for keys, movements, outputs and datasets
OTHER_WORDS = {
    "friction": "mu mu_s mu_k coefficient coulomb friction_coefficient coefficient_of_friction",
    "press": "push indent touch approach poke probe tap",
    "slide": "shear drag move translate",
    "twist": "rotate turn spin torsion",
    "hold": "wait pause stay dwell",
    "release": "retract unload lift_off withdraw",
    "indenter": "object probe shape",
    "rgb": "image images img picture photo camera color colour tactile_image",
    "height": "depth depth_map heightmap height_map deformation",
    "traction": "pressure shear_traction contact_map slip",
    "force": "wrench torque ft net_force",
    "stress": "nodal_stress cauchy_stress von_mises",
    "markers": "dots marker_flow marker_motion",
    "sensor_overrides": "gel plate coating walls leds camera",
    "youngs_modulus_mpa": "e modulus elasticity stiffness young youngs",
    "poissons_ratio": "nu poisson",
    "shape": "type kind geometry",
    "radius_mm": "r",
}


@dataclass(frozen=True)
class Issue:
    """One error of one value."""

    path: KeyPath
    message: str
    at_key: bool = False  # point at the key, not at the value
    meant: str = ""  # the key that was probably meant

    def point(self, tree: Tree) -> str:
        """The message, then the source line with a caret under the place."""
        return self.mark(tree).point(": ".join(filter(None, [format_path(self.path), self.message])))

    def place(self, tree: Tree) -> str:
        """The message alone, with its place: one line."""
        return self.point(tree).split("\n", 1)[0]

    def mark(self, tree: Tree) -> Mark:
        """Position of the value (or key); if it was not written, that of the nearest key around it."""
        spot = tree.spot(self.path)
        return spot.key if self.at_key or self.path not in tree.spots else spot.value


def validate(model: type[Model], data: Any) -> tuple[Model | None, list[Issue]]:
    """Validate plain data strictly (neither text nor true is a number): the model, or all problems."""
    if _has_huge(data):  # seldom, and the paths of all numbers take longer than all else here
        huge = [(path, value) for path, value in leaves(data) if _has_huge(value) and path[-1:] != ("seed",)]
        if huge:
            return None, [Issue(path, f"must be within {MAX_NUMBER:g} (got {value:g})") for path, value in huge]
    try:
        return model.model_validate_json(json.dumps(data), strict=True), []
    except ValidationError as error:
        problems = [_problem(model, data, e) for e in error.errors(include_url=False) if not _repeats_another(data, e)]
        misspelt = {(*p.path[:-1], p.meant) for p in problems if p.meant}
        return None, _together([p for p in problems if p.path not in misspelt])  # misspelt, not missing


def _has_huge(data: Any) -> bool:
    """Whether one of these plain values is a finite number beyond MAX_NUMBER."""
    if isinstance(data, dict):
        return any(map(_has_huge, data.values()))
    if isinstance(data, list | tuple):
        return any(map(_has_huge, data))
    return isinstance(data, int | float) and MAX_NUMBER < abs(data) < math.inf


def explained(model: type[BaseModel], data: Any, error: ValidationError) -> UserError:
    """The error of a model that was made in Python, one line a problem."""
    problems = [_problem(model, data, e) for e in error.errors(include_url=False)]
    misspelt = {(*p.path[:-1], p.meant) for p in problems if p.meant}
    lines = [": ".join(filter(None, [format_path(p.path), p.message])) for p in problems if p.path not in misspelt]
    return UserError(f"{model.__name__}: {line}" for line in lines)


def _together(problems: list[Issue]) -> list[Issue]:
    """Merge the missing keys of one mapping into one problem, at the place of the first."""
    lacking: dict[KeyPath, list[Issue]] = {}
    for problem in problems:
        if problem.message.startswith(MISSING_MESSAGE):
            lacking.setdefault(problem.path[:-1], []).append(problem)
    out = []
    for problem in problems:
        group = lacking.get(problem.path[:-1], []) if problem.message.startswith(MISSING_MESSAGE) else []
        if len(group) > 1 and problem is group[0]:
            names = [f"{p.path[-1]}{p.message.removeprefix(MISSING_MESSAGE)}" for p in group]
            out.append(Issue(problem.path[:-1], f"lacks {', '.join(names)}", at_key=True))
        elif len(group) < 2:
            out.append(problem)
    return out


def report(problems: Iterable[tuple[Issue, Tree]]) -> UserError:
    """One error with all problems, in the order of their places in the files."""
    placed = [(problem.mark(tree), problem.point(tree)) for problem, tree in problems]
    placed.sort(key=lambda pair: (pair[0].source.name, pair[0].line, pair[0].column))
    return UserError(dict.fromkeys(text for _, text in placed))


def _repeats_another(data: Any, error: ErrorDetails) -> bool:
    """Whether a list is reported as too short only because its items are wrong, which is reported separately."""
    written = at(data, _path_in_data(data, tuple(error["loc"]), missing=False))
    return error["type"] == "too_short" and len(written or ()) >= error["ctx"]["min_length"]


def _problem(model: type[BaseModel], data: Any, error: ErrorDetails) -> Issue:
    """One entry of ValidationError.errors() as a Issue."""
    kind, ctx, given = error["type"], error.get("ctx", {}), error["input"]
    loc = tuple(error["loc"])
    path = _path_in_data(data, loc, missing=kind == "missing")
    got = f"(got {describe(given)})"
    if kind == "extra_forbidden":
        here = [each for each in _kinds(model, loc[:-1]) if _is_model(each)]
        if other := _of_another_kind(model, loc):
            return Issue(path, other, at_key=True)
        names = list(dict.fromkeys(name for each in here for name in each.model_fields))
        meant = nearest(str(loc[-1]), names)
        return Issue(path, unknown("key", str(loc[-1]), names), at_key=True, meant=meant)
    if kind == "missing":
        return Issue(path, f"{MISSING_MESSAGE}{needs(model, loc)}", at_key=True)
    if kind in TYPE_NOUNS:
        return Issue(path, f"must be {TYPE_NOUNS[kind]} {got}")
    if kind in BOUND_TEXTS:
        word, bound = BOUND_TEXTS[kind]
        return Issue(path, f"must be {word} {describe(ctx[bound])} {got}")
    if kind in ("literal_error", "union_tag_invalid"):
        expected = ctx.get("expected") or ctx.get("expected_tags") or ""
        names = [name.strip().strip("'") for name in expected.replace(" or ", ", ").split(",")]
        if kind == "union_tag_invalid":
            key = str(ctx.get("discriminator", "")).strip("'()")  # a key, or a function of that name
            path, given = (*path, key), ctx.get("tag")
        return Issue(path, one_of(given, names))
    if kind == "union_tag_not_found":
        key = str(ctx.get("discriminator", "")).strip("'")
        if isinstance(given, dict) and key.isidentifier():
            return Issue((*path, key), MISSING_MESSAGE, at_key=True)
        return Issue(path, f"must be a mapping {got}")
    if kind == "string_pattern_mismatch":
        return Issue(path, f"must be letters, digits, dots, dashes and underscores only {got}")
    if kind.endswith(("too_short", "too_long")):
        count = f"at least {ctx['min_length']}" if "min_length" in ctx else f"at most {ctx['max_length']}"
        if kind.startswith("string"):
            return Issue(path, f"must have {count} characters {got}")
        return Issue(path, f"must hold {count} (got {ctx.get('actual_length')})")
    return Issue(path, error["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, "))


def one_of(given: Any, names: list[str]) -> str:
    """`must be one of a, b, c (got 'x'), did you mean ...?`"""
    hint = suggest(given, names) if isinstance(given, str) else ""
    expected = names[0] if len(names) == 1 else "one of " + ", ".join(names)
    return f"must be {expected} (got {describe(given)}){hint}"


def unknown(noun: str, word: str, known: Iterable[str]) -> str:
    """`unknown key, did you mean X?; there are: W, X`: every name, after the one that was probably meant."""
    return f"unknown {noun}{suggest(word, known)}; there are: {', '.join(known)}"


def suggest(word: str, known: Iterable[str]) -> str:
    """`, did you mean X?` when something known is probably meant by `word`, else nothing."""
    name = nearest(word, known)
    return f", did you mean {name}?" if name else ""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known name that is probably meant by `word`, or "": one that begins so, as x_mm with x, one spelt alike, or
    another word for it."""
    ordered = sorted(known)
    close = [name for name in ordered if name.startswith(word if len(word) > 2 else f"{word}_")]
    close = close or difflib.get_close_matches(word, ordered, n=1, cutoff=MIN_LIKENESS)
    close = close or [name for name in ordered if word.lower() in OTHER_WORDS.get(name, "").split()]
    return close[0] if close else ""


def _path_in_data(data: Any, loc: KeyPath, *, missing: bool) -> KeyPath:
    """pydantic's location without the union tags that it inserts: only steps that exist in the data."""
    path: KeyPath = ()
    for i, step in enumerate(loc):
        here = at(data, path)
        last = i == len(loc) - 1
        if (isinstance(here, dict) and step in here) or (isinstance(here, list) and isinstance(step, int)):
            path = (*path, step)
        elif last and isinstance(here, dict) and step in (here.get(tag, usual) for tag, usual in CHOICE_KEYS.items()):
            continue  # of the whole mapping, of this kind
        elif last and isinstance(here, dict) and (missing or str(step).isidentifier()):
            path = (*path, step)  # a key that was not written: missing, or a default that does not fit
    return path


def needs(model: type[BaseModel], loc: KeyPath) -> str:
    """` (width_mm, height_mm)`: the required keys of a mapping, or of each item of a list, at `loc`; or nothing."""
    here = _kinds(model, loc)
    lists = [kind for kind in here if get_origin(kind) is tuple]
    here = [inner for kind in lists for inner in _step(kind, 0)] or here
    kind = next((kind for kind in here if _is_model(kind) and kind is not model), None)
    if kind is None:
        return ""
    chosen = [name for name, usual in CHOICE_KEYS.items() if usual is None]  # in Python the class gives them
    names = ", ".join(name for name, field in kind.model_fields.items() if field.is_required() or name in chosen)
    if lists:
        return f" (a list, each with {names})" if names else " (a list)"
    return f" ({names})"


def _of_another_kind(model: type[BaseModel], loc: KeyPath) -> str:
    """`is a key of layout: hexagonal, and layout is grid here: ...`, if another kind of mapping has the key; or ""."""
    tags = {
        tag: (name, kind)
        for kind in _kinds(model, loc[:-2])
        if _is_model(kind)
        for name, field in kind.model_fields.items()
        if get_origin(field.annotation) is Literal
        for tag in get_args(field.annotation)
    }
    here, key = (loc[-2] if len(loc) > 1 else None), loc[-1]
    if here not in tags:
        return ""
    by = tags[here][0]
    others = [str(tag) for tag, (name, kind) in tags.items() if name == by and key in kind.model_fields]
    if not others:
        return ""
    return f"is a key of {by}: {' and '.join(others)}, and {by} is {here} here: leave it out, or change {by}"


def _kinds(model: type[BaseModel], loc: KeyPath) -> list[Any]:
    """The types that a value at `loc` may have."""
    here: list[Any] = [model]
    for step in loc:
        here = [kind for each in here for kind in _step(each, step)] or here
    return here


def _step(kind: Any, step: str | int) -> list[Any]:
    """The types one step of a location below `kind`; the tag of a union selects a model."""
    if _is_model(kind):
        if step in kind.model_fields:
            return _flat(kind.model_fields[step].annotation)
        tags = [get_args(f.annotation) for f in kind.model_fields.values() if get_origin(f.annotation) is Literal]
        return [kind] if any(step in names for names in tags) else []
    if isinstance(step, int) and get_origin(kind) in (tuple, list, frozenset):
        return [one for arg in get_args(kind) if arg is not Ellipsis for one in _flat(arg)]
    if get_origin(kind) is dict:
        return _flat(get_args(kind)[1])
    return []


def _flat(kind: Any) -> list[Any]:
    """The members of a union, without Annotated."""
    if get_origin(kind) is Annotated:
        return _flat(get_args(kind)[0])
    if get_origin(kind) in (Union, types.UnionType):
        return [one for arg in get_args(kind) for one in _flat(arg)]
    return [kind]


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
