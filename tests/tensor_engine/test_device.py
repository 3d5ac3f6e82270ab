"""How the batch engine takes a device."""

import ctypes
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.needs import needs

torch = needs("torch")

from tacgen.tensor_engine import device as devices


class Driver:
    """CUDA's driver as far as it is called, of a machine with three GPUs, whose handles are not their numbers."""

    def __init__(self, calls: list[Any]) -> None:
        self.calls = calls

    def cuInit(self, flags: int) -> int:
        return 0

    def cuDeviceGet(self, handle: Any, number: int) -> int:
        handle._obj.value = 10 + number
        return 0 if number < 3 else 101

    def cuDevicePrimaryCtxSetFlags_v2(self, handle: Any, flags: int) -> int:
        self.calls.append((handle.value, flags))
        return 0


def test_a_process_sleeps_while_it_waits_for_its_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Driver(calls) if name == "libcuda.so.1" else None)
    monkeypatch.setattr(torch.cuda, "set_device", lambda device: calls.append(device))
    monkeypatch.setattr(torch.cuda, "Stream", lambda priority: priority)
    monkeypatch.setattr(torch.cuda, "set_stream", lambda stream: calls.append(f"stream of {stream}"))
    monkeypatch.setattr(torch.cuda, "set_per_process_memory_fraction", lambda part: calls.append(part))
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda: (5, 8))
    monkeypatch.setattr(devices, "_part", 1.0)
    monkeypatch.setattr(devices, "_urgent", {})
    assert devices.chosen("cuda:2", 0.5) == 4.0
    # the driver first: flags count for a GPU that was not used yet
    assert calls == [(12, 4), "cuda:2", "stream of -1", 0.5]
    calls.clear()
    devices._wait_asleep(7)  # there is none
    assert calls == []
    devices.chosen("cpu", 0.5)
    assert calls == []
    devices.shared("cuda:1")  # to draw: work of the usual priority
    assert calls == [(11, 4), "cuda:1"]


def test_memory_beside_workers_that_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: SimpleNamespace(total_memory=7e9))
    assert [devices.beside("cuda:0", count) for count in (0, 2, 16)] == pytest.approx([1.0, 0.8, 0.5])
    assert devices.beside("cpu", 16) == 1.0


def test_without_the_driver_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(name: str) -> Any:
        raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", none)
    devices._wait_asleep(0)


def test_streams_for_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "Stream", lambda device, priority: (str(device), priority))
    gpu = torch.device("cuda:1")
    assert [devices.stream(gpu, urgent) for urgent in (True, False)] == [("cuda:1", -1), ("cuda:1", 0)]
    assert devices.stream(torch.device("cpu"), True) is None
