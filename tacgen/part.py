"""What every piece of a file a person writes has in common."""

from pydantic import BaseModel, ConfigDict


class Part(BaseModel):
    """A frozen piece of a recipe or sensor file in which an unknown key is an error, and so is nan or inf."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
