"""The doctor tries things, never crashes, and tells what is needed from what is only nice."""

import json
import re
import tomllib
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.command import tacgen_, told

from tacgen.cli import doctor
from tacgen.recipe.row import Row


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch):
    """Probing Mitsuba starts processes; here it has been done."""
    tried = [
        SimpleNamespace(variant="llvm_ad_rgb", library="", works=False, note="no LLVM found"),
        SimpleNamespace(variant="scalar_rgb", library="", works=True, note="renders"),
    ]
    monkeypatch.setattr("tacgen.render.mitsuba_variants.variants", lambda: tried)


def test_everything_works_on_this_machine():
    found = {f.name: f for f in doctor.examine()}
    assert not [f for f in found.values() if f.needed and not f.ok]
    assert found["rendering"].note == "uses scalar_rgb"
    assert not found["llvm_ad_rgb"].ok
    assert found["HDF5"].ok
    assert "ok  HDF5" in told("doctor")


def test_every_package_that_is_installed_with_tacgen_is_looked_for():
    project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]
    asked = {re.split("[<>=]", name)[0] for name in project["dependencies"]}
    assert asked == {*doctor.NEEDED_PACKAGES, *doctor.REPLACEABLE_PACKAGES}


def test_what_is_missing_is_a_finding_and_exit_code_1(monkeypatch: pytest.MonkeyPatch):
    def gone():
        raise ImportError("no module named mitsuba")

    monkeypatch.setattr("tacgen.render.mitsuba_variants.variants", gone)
    monkeypatch.setattr(doctor, "NEEDED_PACKAGES", ("numpy", "no-such-package"))
    monkeypatch.setattr(doctor, "REPLACEABLE_PACKAGES", ("no-such-solver",))
    done = tacgen_("doctor", "--json")
    assert done.exit_code == 1
    found = {f["name"]: f for f in json.loads(done.stdout)}
    said = "ImportError: no module named mitsuba"
    assert found["rendering"] == {"name": "rendering", "ok": False, "note": said, "needed": True}
    assert (found["no-such-package"]["ok"], found["no-such-package"]["needed"]) == (False, True)
    assert (found["no-such-solver"]["ok"], found["no-such-solver"]["needed"]) == (False, False)
    assert found["numpy"]["ok"]


def test_it_prepares_what_first_runs_need_if_asked(monkeypatch: pytest.MonkeyPatch):
    """With every output on every sensor: markers where it has some."""

    def run(rows: list[Row], folder: Path) -> list[SimpleNamespace]:
        outputs[name := rows[0].sensor.name] = rows[0].recipe.outputs
        stalled = name == "digit"
        status, reason = ("rejected", "frame 1 of 1: stalled") if stalled else ("ok", "")
        return [SimpleNamespace(status=status, reason=reason, seconds={"compile": 2.0, "solve": 1.0})]

    outputs = dict[str, frozenset[str]]()
    monkeypatch.setattr("tacgen.batch.local.Pool", lambda count: nullcontext(SimpleNamespace(run=run)))
    monkeypatch.setattr("tacgen.recipe.assets.list_sensors", lambda: ["gelsight_mini", "digit", "nobody"])
    assert "digit" not in told("doctor")
    warmed = tacgen_("doctor", "--warm")
    assert warmed.exit_code == 1
    assert "ok  gelsight_mini        3 s, 2 s of them compiling\nBAD digit                frame 1" in warmed.stdout
    assert "BAD nobody " in warmed.stdout
    assert outputs["gelsight_mini"] - outputs["digit"] == {"markers"}
    assert outputs["digit"] >= {"force_map", "rgb", "stress"}
