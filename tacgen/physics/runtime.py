"""Warp: its settings, machine code that is kept for the next process, and launches on arrays of NumPy or PyTorch."""

import math
import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from tacgen.base import array_cache, compiled

MODULE = "tacgen.physics"  # of all kernels that a core runs


@cache
def load(module: str, device: str) -> None:
    """Load the machine code of a module; for a core the first process compiles it, and others find it."""
    from tacgen.physics import tangents

    assert module == (tangents.double() if module == MODULE else tangents.single()).module
    if device != "cpu":
        wp.load_module(module, device)
        return
    file, key = compiled.folder() / f"{module}.entry", wp.get_module(module).hash_module().hex()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        if (code := array_cache.read(file, key)) is None:
            with compiled.compiling(), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that the code is of this processor alone: `folder` is, too
                (path,) = wp.compile_aot_module(module, device="cpu", module_dir=folder)
            code = path.name.encode() + b"\n" + path.with_name(path.name.split(".cpu")[0] + ".meta").read_bytes()
            code = array_cache.store(file, key, code + b"\n\n" + path.read_bytes())
        head, content = code.split(b"\n\n", 1)
        name, meta = head.split(b"\n", 1)
        (folder / name.decode()).write_bytes(content)
        (folder / (name.decode().split(".cpu")[0] + ".meta")).write_bytes(meta)
        wp.load_aot_module(module, device="cpu", module_dir=folder)


def array(values: Any, dtype: Any) -> wp.array:
    """A view of an array of NumPy, or of a tensor, whose last axes are those of `dtype`."""
    if isinstance(values, np.ndarray):
        return wp.array(values, dtype=dtype, device="cpu", copy=False)
    return wp.from_torch(values, dtype=dtype)


class Launches:
    """Launches on a core of one object's kernels, recorded: to prepare one takes longer than to run it on few cells."""

    def __init__(self) -> None:
        self._recorded: dict[tuple[Any, ...], Any] = {}

    def __call__(self, kernel: wp.Kernel, dim: tuple[int, ...], *values: Any) -> None:
        """As `launch`, on arrays of NumPy, of which only the addresses change, and on those of Warp that stay."""
        plain = [np.ascontiguousarray(value) if isinstance(value, np.ndarray) else value for value in values]
        key = kernel, dim, *(_fixed(value) for value in plain)
        if key not in self._recorded:
            self._recorded[key] = launch(kernel, dim, *plain, record=True)
        recorded = self._recorded[key]
        for k, value in enumerate(plain, 1):  # the first parameter is the launch's size
            if isinstance(value, np.ndarray):
                recorded.params[k].data = value.ctypes.data
        recorded.launch()


def _fixed(value: Any) -> Any:
    """The part of an argument that a recorded launch keeps."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype
    return id(value) if isinstance(value, wp.array) else value


def launch(kernel: wp.Kernel, dim: tuple[int, ...], *values: Any, record: bool = False) -> Any:
    """Run a kernel on its arguments, the outputs among them: arrays of Warp, NumPy or PyTorch; None is one of no rows.

    On a GPU it runs in PyTorch's stream. record: returns the launch instead.
    """
    kinds = [argument.type for argument in kernel.adj.args]
    found = [
        array(value, kind.dtype) if isinstance(kind, wp.array) and not isinstance(value, wp.array | None) else value
        for kind, value in zip(kinds, values, strict=True)
    ]
    device = next(value.device for value in found if isinstance(value, wp.array))
    inputs = [_none(k.dtype, k.ndim, device.alias) if v is None else v for k, v in zip(kinds, found, strict=True)]
    load(kernel.module.name, device.alias)
    stream = None
    if device.is_cuda:
        import torch

        stream = _stream(torch.cuda.current_stream().cuda_stream, device.alias)
    return wp.launch(kernel, dim=dim, inputs=inputs, device=device, stream=stream, record_cmd=record)


@cache
def _stream(handle: int, device: str) -> wp.Stream:
    """Warp's object for a stream of PyTorch; a new one each time would be registered and removed in recordings."""
    return wp.Stream(device, cuda_stream=handle)


def room(dtype: Any, shape: tuple[int, ...], like: Any) -> wp.array:
    """An array of a Warp type, not filled, where a tensor is: of PyTorch's memory, which recordings need."""
    if not like.is_cuda:
        return wp.empty(shape, dtype=dtype, device="cpu")
    import torch

    memory = torch.empty(math.prod(shape) * wp.types.type_size_in_bytes(dtype), dtype=torch.uint8, device=like.device)
    held = wp.array(ptr=memory.data_ptr(), dtype=dtype, shape=shape, device=wp.device_from_torch(like.device))
    held.memory = memory  # lives as long
    return held


@cache
def _none(dtype: Any, ndim: int, device: str) -> wp.array:
    return wp.zeros((0,) * ndim, dtype=dtype, device=device)
