"""The devices that the batch engine runs on."""

import ctypes
import gc

import torch

CPU_MEMORY_BYTES = 4e9  # [bytes] used where there is no GPU
# part of a process's memory in use beyond which its allocator gives back what it keeps for later, since a recording can
# not take that; and beyond which there is none for further recordings
MAX_IDLE_MEMORY_SHARE, MAX_MEMORY_SHARE = 0.6, 0.85
URGENT_PRIORITY = -1  # priority of a stream above the usual one
# of the memory of a GPU, what a process takes that draws on it: three quarters are PyTorch's and CUDA's own [bytes];
# and what they take together at most
DRAWING_PROCESS_BYTES, MIN_SHARE_BESIDE_DRAWING = 0.7e9, 0.5
BLOCKING_SYNC = 4  # CU_CTX_SCHED_BLOCKING_SYNC of CUDA's driver
_urgent: dict[str, torch.cuda.Stream] = {}  # the stream of this process on each device
_part = 1.0  # of a GPU's memory, that this process may use


def usable() -> list[str]:
    """The devices for scenes: all GPUs that PyTorch can use."""
    return [f"cuda:{k}" for k in range(torch.cuda.device_count())]


def chosen(device: str, part: float = 1.0) -> float:
    """Work on this device from now on in this process, with a part of its memory; returns its bytes."""
    if not device.startswith("cuda"):
        return part * CPU_MEMORY_BYTES
    global _part
    _part = part
    _wait_asleep(torch.device(device).index)
    torch.cuda.set_device(device)
    if device not in _urgent:  # one stream, since memory is kept for the stream that it was used in
        _urgent[device] = torch.cuda.Stream(priority=URGENT_PRIORITY)
    torch.cuda.set_stream(_urgent[device])
    torch.cuda.set_per_process_memory_fraction(part)
    return part * float(torch.cuda.mem_get_info()[1])


def beside(device: str, drawing: int) -> float:
    """Part of a device's memory that is left beside so many processes that draw on it."""
    if not device.startswith("cuda"):
        return 1.0
    return max(
        MIN_SHARE_BESIDE_DRAWING,
        1 - drawing * DRAWING_PROCESS_BYTES / float(torch.cuda.get_device_properties(device).total_memory),
    )


def shared(device: str) -> None:
    """Work on this device from now on in this process, which solves nothing: while it waits it sleeps, and the work of
    those that solve comes first."""
    if device.startswith("cuda"):
        _wait_asleep(torch.device(device).index)
        torch.cuda.set_device(device)


def _wait_asleep(number: int) -> None:
    """Have this process sleep while it waits for a GPU, which it has not used yet. PyTorch lets it ask again and again
    (its issue 28224), and so takes a core from those that label and draw."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:  # another system's name: it works as well, for more of a core
        return
    handle = ctypes.c_int()
    if driver.cuInit(0) == 0 and driver.cuDeviceGet(ctypes.byref(handle), number) == 0:
        driver.cuDevicePrimaryCtxSetFlags_v2(handle, BLOCKING_SYNC)


def stream(device: torch.device, urgent: bool) -> torch.cuda.Stream | None:
    """A new stream of the usual priority, or of one above it: a GPU that has room for a block of threads gives it to
    urgent streams first. CUDA graphs have the priority of the stream in which they were captured. None: no GPU."""
    return torch.cuda.Stream(device, priority=URGENT_PRIORITY if urgent else 0) if device.type == "cuda" else None


def full(device: torch.device) -> bool:
    """Whether there is no memory for a recording; what the allocator only keeps for later is given back before."""
    if device.type != "cuda":
        return False
    most = _part * torch.cuda.mem_get_info(device)[1]
    if torch.cuda.memory_reserved(device) > MAX_IDLE_MEMORY_SHARE * most:
        torch.cuda.empty_cache()
    return bool(torch.cuda.memory_reserved(device) > MAX_MEMORY_SHARE * most)


def cleared(device: str) -> None:
    """Give back the memory of what is no longer used, recordings among it."""
    gc.collect()
    if device.startswith("cuda"):
        torch.cuda.empty_cache()


def named(device: str) -> str:
    """A device with its name, and the version of PyTorch, for bundles."""
    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else device
    return f"{name}, torch {torch.__version__}"
