"""Networks for normals are trained in fewer steps here, and one instead of several."""

import pytest

from tacgen.calibrate import normal_net, render_comparison, steps


@pytest.fixture(autouse=True)
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the tests compare is several times larger than the loss of accuracy."""
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 60)
    monkeypatch.setattr(normal_net, "ENSEMBLE_SIZE", 1)
    monkeypatch.setattr(steps, "MAX_WORKERS", 1)  # other processes would know none of this


@pytest.fixture
def few_dents(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that look whether normals are judged, not at their error: the network learns from few."""
    monkeypatch.setattr(render_comparison, "TRAINING_DENTS", 4)
    monkeypatch.setattr(normal_net, "TRAINING_SAMPLES", 500)
    monkeypatch.setattr(normal_net, "MAX_LBFGS_STEPS", 20)
