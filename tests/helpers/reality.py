"""What the tests against photographs share: where those are, and a shipped sensor against them."""

import pytest

from benchmarks import photographs
from tacgen.calibrate import solved_presses
from tacgen.calibrate.render_comparison import Comparison
from tacgen.recipe import assets, loading


def needs(name: str) -> pytest.MarkDecorator:
    """Skip where a sensor's photographs are absent."""
    reason = f"no photographs in {photographs.reference()} (set TACGEN_REFERENCE)"
    return pytest.mark.skipif(not photographs.there(name), reason=reason)


def sensor(name: str):
    """A shipped sensor file."""
    return loading.read_sensor(assets.sensor_path(name))[0]


def against_photographs(name: str):
    """A shipped sensor's likeness to its unit's presses."""
    unit, shipped = photographs.unit(name), sensor(name)
    faces = [solved_presses.face(shipped, press, {}) for press in unit.presses]
    return Comparison(shipped).likeness(unit.presses, faces, unit.untouched)
