"""Warp: its settings, machine code that is kept for the next process, and launches on arrays of NumPy or PyTorch."""

import ctypes
import importlib
import math
import tempfile
import threading
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from tacgen.base import array_cache, compiled

MODULE = "tacgen.physics"  # of all kernels of the solver that a core runs
OPTICS = "tacgen.optics"  # of all kernels of pictures
# the files of this folder whose kernels belong to a module of machine code; it is loaded when all of them are known
KERNEL_FILES = {
    MODULE: ("elements", "tangents", "raster", "interpolation"),
    OPTICS: (
        *("coat", "faces", "filters", "noise", "pictures", "response", "sampling", "shadows", "strip_columns"),
        *("strips", "taxim"),
    ),
}
MAX_PREPARED_LAUNCHES = 256  # launches of one object that stay prepared


@cache
def load(module: str, device: str) -> None:
    """Load the machine code of a module; for a core the first process compiles it, and others find it."""
    for kernels in KERNEL_FILES.get(module, ()):
        importlib.import_module(f"tacgen.physics.{kernels}")
    if module == MODULE:
        from tacgen.physics import tangents

        tangents.double()
    if device != "cpu":
        wp.load_module(module, device)
        return
    wp.set_module_options({"block_dim": 1}, wp.get_module(module))  # as `wp.launch` on a core
    if module == OPTICS:
        from tacgen.physics import COMPILER_FLAGS

        wp.set_module_options({"cpu_compiler_flags": COMPILER_FLAGS + " -ffp-contract=fast"}, wp.get_module(module))
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
    """Launches on a core of one object's kernels, prepared: to prepare one takes longer than to run it on few cells."""

    def __init__(self) -> None:
        self._prepared: dict[tuple[Any, ...], PreparedLaunch] = {}

    def __call__(self, kernel: wp.Kernel, dim: tuple[int, ...], *values: Any) -> None:
        """As `launch`, on arrays of NumPy, whose lengths and addresses may change, and on those of Warp that stay."""
        if 0 in dim:
            return
        key: list[Any] = [kernel]
        rows, plain = [], []
        for value, rank in zip(values, _ranks(kernel), strict=True):
            if isinstance(value, np.ndarray):
                row = value if value.flags.c_contiguous else np.ascontiguousarray(value)
                key.append((row.shape[rank:], row.dtype.char))
                rows.append(row)  # lives until the kernel has run
                plain.append(row)
            else:
                key.append(id(value) if isinstance(value, wp.array) else value)
                plain.append(value)
        asked = tuple(key)
        prepared = self._prepared.get(asked)
        if prepared is None:
            if len(self._prepared) == MAX_PREPARED_LAUNCHES:
                del self._prepared[next(iter(self._prepared))]
            prepared = self._prepared[asked] = PreparedLaunch(kernel, dim, plain)
        prepared.run(dim, rows)


@cache
def _ranks(kernel: wp.Kernel) -> tuple[int, ...]:
    """The axes of each argument of a kernel, beside those of its values; 0 of a number."""
    return tuple(getattr(argument.type, "ndim", 0) for argument in kernel.adj.args)


class PreparedLaunch:
    """A kernel's launch on a core with arrays of NumPy of certain types; size, addresses and shapes are given to
    `run`."""

    def __init__(self, kernel: wp.Kernel, dim: tuple[int, ...], values: list[Any]) -> None:
        recorded = launch(kernel, dim, *values, record=True)
        bounds, *params = recorded.params  # the first parameter is the launch's size
        names = [f"p{k}" for k in range(len(params))]
        fields = [(name, type(param)) for name, param in zip(names, params, strict=True)]
        given: Any = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*params)
        arrays = [(name, value) for name, value in zip(names, values, strict=True) if isinstance(value, np.ndarray)]
        self._dim, self._bounds = dim, bounds
        self._arrays, self._shapes = [getattr(given, name) for name, _ in arrays], [row.shape for _, row in arrays]
        self._stays = [value for value in values if isinstance(value, wp.array)], recorded.module_exec, given
        self._function, self._arguments = recorded.hooks.forward, (ctypes.byref(bounds), ctypes.byref(given))

    def run(self, dim: tuple[int, ...], rows: list[np.ndarray]) -> None:
        if dim != self._dim:
            self._dim = dim
            self._bounds.__init__(dim)
        for k, (there, row) in enumerate(zip(self._arrays, rows, strict=True)):
            there.data = row.__array_interface__["data"][0]
            if row.shape != self._shapes[k]:
                self._shapes[k] = row.shape
                for axis in range(there.ndim):
                    there.shape[axis], there.strides[axis] = row.shape[axis], row.strides[axis]
        self._function(*self._arguments)


_threads = threading.local()


def call(kernel: wp.Kernel, dim: tuple[int, ...], *values: Any) -> None:
    """As `launch`, on a core, on arrays of NumPy; launches on arrays of the same types are prepared once."""
    if not hasattr(_threads, "launches"):
        _threads.launches = Launches()
    _threads.launches(kernel, dim, *values)


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
