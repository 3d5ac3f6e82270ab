"""The devices that the batch engine runs on."""

import torch

CPU_MEMORY = 4e9  # [bytes] used where there is no GPU


def usable() -> list[str]:
    """The devices for scenes: all GPUs that PyTorch can use."""
    return [f"cuda:{k}" for k in range(torch.cuda.device_count())]


def chosen(device: str) -> float:
    """Work on this device from now on in this process; returns the bytes that it has."""
    if not device.startswith("cuda"):
        return CPU_MEMORY
    torch.cuda.set_device(device)
    return float(torch.cuda.mem_get_info()[1])


def named(device: str) -> str:
    """A device with its name, and the version of PyTorch, for bundles."""
    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else device
    return f"{name}, torch {torch.__version__}"
