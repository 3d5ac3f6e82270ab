"""Reading of JSON files written by tacgen: of limited size, validated, with errors of one line."""

from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, JsonValue, TypeAdapter, ValidationError

from tacgen.base import regular_file
from tacgen.base.csv_table import MAX_TABLE_VALUE
from tacgen.base.errors import UserError

MAX_JSON_BYTES = 2**30  # bytes of a file
T = TypeVar("T")


class Stored(BaseModel):
    """Part of a file written by tacgen; unknown keys, of later versions, are ignored."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


def _step(name: str) -> str:
    if name in ("", ".", "..") or "/" in name or not name.isprintable():
        raise ValueError("must be the name of a file or scene")
    return name


Name = Annotated[str, AfterValidator(_step)]  # a single path component, so that it cannot point outside the folder


def _bounded(value: JsonValue) -> JsonValue:
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _bounded(part)
    if isinstance(value, int | float) and not abs(value) < MAX_TABLE_VALUE:
        raise ValueError(f"must be a finite number below {MAX_TABLE_VALUE:g}")
    return value


Value = Annotated[JsonValue, AfterValidator(_bounded)]  # of any kind, with numbers that can be computed with


def read(kind: type[T], path: Path) -> T:
    """The contents of a file. Raises UserError: it cannot be read, or is damaged."""
    content = regular_file.content(path, MAX_JSON_BYTES)
    try:
        return parsed(kind, content)
    except ValueError as error:
        raise UserError(f"{path}: damaged: {error}") from None


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def parsed(kind: type[T], content: str | bytes) -> T:
    """The contents of a text. Raises ValueError, in one line: not JSON, or not of this type."""
    try:
        value: T = _adapter(kind).validate_json(content)  # type: ignore[arg-type]
        return value
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(str(step) for step in first["loc"])
        said = ": ".join(filter(None, (where, first["msg"])))
        raise ValueError(said.encode("ascii", "backslashreplace").decode()) from None
