"""Functions that a GPU runs compiled can be traced whole, and give what they give as they are written."""

from functools import partial

import pytest
import torch

from tacgen.fem.potential import Projection
from tacgen.tensor_engine import fused
from tensor_engine import test_contact, test_elements


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fused, "wanted", lambda _: True)
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="eager"))


@pytest.mark.slow
@pytest.mark.usefixtures("traced")
def test_compiled_functions_are_those_that_are_written() -> None:
    case = test_elements.Case()
    for row in range(len(test_elements.SCENES)):
        test_elements.test_energy_forces_and_mixed_pressure_are_those_of_one_scene(case, row)
    test_elements.test_tangents_are_those_of_one_scene(case, Projection.NONE, True)
    test_contact.test_forces_and_tangents_are_those_of_the_cpu(0.05, True)
    test_contact.test_merit_and_longest_steps_are_those_of_the_cpu()


def test_on_a_cpu_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "compile", None)
    assert fused.fused(lambda x: x + 1)(torch.ones(1)).tolist() == [2.0]
