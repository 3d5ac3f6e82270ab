"""Base class and shared types of the models of recipe and sensor files."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticUndefined

from tacgen.sensor.yaml_source import CHOICE_KEYS

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Index = Annotated[float, Field(ge=1, le=4)]  # of refraction
Item = TypeVar("Item")
Three = tuple[Item, Item, Item]
FilePath = Annotated[str, Field(min_length=1)]  # relative to the folder of the file in which it is written
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # hash that the named file must have; stored in bundles
Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
NO_SOURCE = "not stated"  # the default `source` of a part: nobody has said where its numbers come from
ONE_KEY: dict[str, Any] = {"minProperties": 1, "maxProperties": 1}  # in a JSON schema


def as_tuple(value: Any) -> Any:
    """A list as a tuple: the strict mode in which values from Python are checked accepts no list."""
    return tuple(value) if isinstance(value, list) else value


def _as_rgb(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value,) * 3
    return as_tuple(value)


# Red, green, blue. A single number stands for three equal ones, so that `vary` can change all three together.
Rgb = Annotated[Three[NotNegative], BeforeValidator(_as_rgb, json_schema_input_type=NotNegative | Three[NotNegative])]
Radii = Annotated[Three[Positive], BeforeValidator(_as_rgb, json_schema_input_type=Positive | Three[Positive])]
Shares = Annotated[Three[Fraction], BeforeValidator(_as_rgb, json_schema_input_type=Fraction | Three[Fraction])]


def _with_tag(schema: dict[str, Any], kind: type[BaseModel]) -> None:
    """Make the key that chooses a mapping's kind required in a JSON schema: Python needs none, the class gives it."""
    for tag, usual in CHOICE_KEYS.items():
        if tag in kind.model_fields and kind.model_fields[tag].get_default() not in (usual, PydanticUndefined):
            schema["required"] = [tag, *schema.get("required", [])]


class Part(BaseModel):
    """A frozen part of a recipe or sensor file. Unknown keys, nan and inf are errors.

    The text below a field is its description in the JSON schema, in docs/SENSOR.md and in `tacgen sensor show`.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, json_schema_extra=_with_tag, use_attribute_docstrings=True
    )

    if not TYPE_CHECKING:  # type checkers see the fields as arguments

        def __init__(self, /, **data: Any) -> None:
            try:
                super().__init__(**data)
            except ValidationError as error:
                from tacgen.sensor.validation_messages import explained

                raise explained(type(self), data, error) from None

        __init__.__pydantic_base_init__ = True  # pydantic itself makes parts without calling it, as it does by default


def exactly_one(what: str, *names: str) -> Any:
    """A validator of a part: exactly one field is given, of those in `names` or of all fields."""

    def check(part: Part) -> Part:
        fields = names or tuple(type(part).model_fields)
        given = [name for name in fields if getattr(part, name) is not None]
        if len(given) != 1:
            raise ValueError(f"must hold exactly {what} of {', '.join(fields)} (got {', '.join(given) or 'none'})")
        return part

    return model_validator(mode="after")(check)
