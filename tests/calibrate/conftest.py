"""Networks for normals are trained in fewer steps here, and one instead of several."""

import pytest

from tacgen.calibrate import normal_net


@pytest.fixture(autouse=True)
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the tests compare is several times larger than the loss of accuracy."""
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 60)
    monkeypatch.setattr(normal_net, "ENSEMBLE_SIZE", 1)
