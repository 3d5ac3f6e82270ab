"""Programs outside of the package, as modules and in processes of their own."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]


def loaded(path: Path) -> ModuleType:
    """The module of a Python file, run afresh."""
    spec = importlib.util.spec_from_file_location(f"program_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


def ran(*words: object, folder: Path | None = None, tacgen: Path = ROOT, **environment: str) -> str:
    """What Python prints that is started with these words and finds the package in the folder `tacgen`."""
    known = os.environ | {"PYTHONPATH": str(tacgen)} | environment
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, env=known, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
