"""The device that the batch engine runs on."""

import torch


def usable() -> str | None:
    """The device for scenes; None without a GPU that PyTorch can use."""
    return "cuda" if torch.cuda.is_available() else None


def named(device: str) -> str:
    """A device with its name, and the version of PyTorch, for bundles."""
    name = torch.cuda.get_device_name() if device.startswith("cuda") else device
    return f"{name}, torch {torch.__version__}"
