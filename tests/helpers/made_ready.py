"""What workers do before their first scene, as files that tell who has done it."""

import os
from pathlib import Path

from tacgen.recipe.row import Row


def noted(row: Row) -> None:
    """Leave a file named after this process, which holds the row's name; then fail."""
    Path(os.environ["MADE_READY"], str(os.getpid())).write_text(row.name)
    raise RuntimeError("a scene would say why")
