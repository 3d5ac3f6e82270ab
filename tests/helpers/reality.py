"""What the tests against photographs share: where those are, the sensor files, and scripts/compare.py's estimators."""

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest
from ruamel.yaml import YAML

from tacgen.recipe.sensor import Sensor

ROOT = Path(__file__).parents[2]
REFERENCE = Path(os.environ.get("TACGEN_REFERENCE", ROOT.parent / "shared" / "reference"))


def needs(folder: str, file: str) -> pytest.MarkDecorator:
    """Skip where the photograph is absent."""
    photos = REFERENCE / folder
    reason = f"no photographs in {photos} (set TACGEN_REFERENCE)"
    return pytest.mark.skipif(not (photos / file).is_file(), reason=reason)


def compare() -> ModuleType:
    """scripts/compare.py as a module."""
    sys.path.insert(0, str(ROOT / "scripts"))
    try:
        spec = importlib.util.spec_from_file_location("compare", ROOT / "scripts" / "compare.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOT / "scripts"))
    return module


def sensor(name: str) -> Sensor:
    """A shipped sensor file."""
    return Sensor.model_validate(YAML(typ="safe").load((ROOT / "sensors" / f"{name}.yaml").read_text()))
