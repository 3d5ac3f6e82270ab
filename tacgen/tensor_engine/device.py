"""The devices that the batch engine runs on."""

import gc

import torch

CPU_MEMORY = 4e9  # [bytes] used where there is no GPU
FULL = 0.9  # part of a process's memory beyond which it has none for further recordings
_part = 1.0  # of a GPU's memory, that this process may use


def usable() -> list[str]:
    """The devices for scenes: all GPUs that PyTorch can use."""
    return [f"cuda:{k}" for k in range(torch.cuda.device_count())]


def chosen(device: str, part: float = 1.0) -> float:
    """Work on this device from now on in this process, with a part of its memory; returns its bytes."""
    if not device.startswith("cuda"):
        return part * CPU_MEMORY
    global _part
    _part = part
    torch.cuda.set_device(device)
    torch.cuda.set_per_process_memory_fraction(part)
    return part * float(torch.cuda.mem_get_info()[1])


def full(device: torch.device) -> bool:
    """Whether nearly all memory that this process may use is in use; what its allocator only keeps for later is given
    back before that is said."""
    if device.type != "cuda":
        return False
    most = FULL * _part * torch.cuda.mem_get_info(device)[1]
    if torch.cuda.memory_reserved(device) > most:
        torch.cuda.empty_cache()
    return bool(torch.cuda.memory_reserved(device) > most)


def cleared(device: str) -> None:
    """Give back the memory of what is no longer used, recordings among it."""
    gc.collect()
    if device.startswith("cuda"):
        torch.cuda.empty_cache()


def named(device: str) -> str:
    """A device with its name, and the version of PyTorch, for bundles."""
    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else device
    return f"{name}, torch {torch.__version__}"
