"""What every piece of a file a person writes has in common."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
FilePath = Annotated[str, Field(min_length=1)]  # starts at the folder of the file that it stands in
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # a file must be this one; bundles say it
Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
ONE_KEY: dict[str, Any] = {"minProperties": 1, "maxProperties": 1}  # in a JSON schema


class Part(BaseModel):
    """A frozen piece of a recipe or sensor file in which an unknown key is an error, and so is nan or inf."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def exactly_one(part: Part, what: str = "one", names: tuple[str, ...] = ()) -> None:
    """Raise ValueError unless one field is given, of `names` or of all."""
    names = names or tuple(type(part).model_fields)
    given = [name for name in names if getattr(part, name) is not None]
    if len(given) != 1:
        raise ValueError(f"must hold exactly {what} of {', '.join(names)} (got {', '.join(given) or 'none'})")
