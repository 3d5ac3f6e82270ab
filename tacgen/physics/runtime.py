"""Warp: its settings, machine code that is kept for the next process, and launches on arrays of NumPy or PyTorch."""

import copy
import ctypes
import importlib
import math
import os
import pickle
import sys
import tempfile
import threading
import warnings
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from tacgen.base import compiled, machine
from tacgen.physics import COMPILER_FLAGS

Array = np.ndarray
MODULE = "tacgen.physics"  # of all kernels of the solver that a core runs
BATCHES = "tacgen.batches"  # of kernels of many scenes alone, which a core runs in tests
ELIMINATION = "tacgen.elimination"  # of kernels in which a warp of a GPU has all registers that there are
OPTICS = "tacgen.optics"  # of all kernels of pictures
# the files of this folder whose kernels belong to a module of machine code; it is loaded when all of them are known
KERNEL_FILES = {
    MODULE: (
        *("assembly", "contact", "distances", "edges", "elements", "interpolation", "jacobian", "raster", "tangents"),
    ),
    ELIMINATION: ("elimination",),
    BATCHES: ("facets", "fronts", "steps", "substitution"),
    OPTICS: (
        *("coat", "faces", "filters", "noise", "pictures", "response", "sampling", "shadows", "strip_columns"),
        *("strips", "taxim"),
    ),
}
MAX_PREPARED_LAUNCHES = 256  # launches of a thread that stay prepared
MAX_PREPARED_GPU_LAUNCHES = 8192  # launches on a GPU that stay prepared: calls have many sizes, each of some kB
BLOCK_THREADS = 256  # of a GPU, in a launch by Warp
WARP_THREADS = 32  # of a GPU: they may read each other's registers
MODULE_THREADS = {ELIMINATION: WARP_THREADS}  # of a block, where blocks of one warp spread over more of the GPU
# bytes from an array's object to the address of its first number, which NumPy's C interface fixes: to read it there
# takes a tenth of the time of __array_interface__
ARRAY_ADDRESS = object.__basicsize__
_Address = ctypes.c_void_p


@cache
def load(module: str, device: str) -> None:
    """Load the machine code of a module; for a core the first process compiles it, and others find it."""
    for kernels in KERNEL_FILES.get(module, ()):
        importlib.import_module(f"tacgen.physics.{kernels}")
    if module == MODULE:
        from tacgen.physics import tangents

        tangents.double()
    if device != "cpu":
        wp.set_module_options({"fast_math": module == ELIMINATION}, wp.get_module(module))  # reciprocals within 2 ulp
        wp.load_module(module, device, block_dim=MODULE_THREADS.get(module, BLOCK_THREADS))
        return
    wp.set_module_options({"block_dim": 1}, wp.get_module(module))  # as `wp.launch` on a core
    if module == OPTICS:
        wp.set_module_options({"cpu_compiler_flags": COMPILER_FLAGS + " -ffp-contract=fast"}, wp.get_module(module))
    key = f"{wp.get_module(module).hash_module().hex()} {wp.__version__} {machine.processor()}"
    name, description, content = pickle.loads(compiled.kept(module, key, partial(_made, module)))
    with tempfile.TemporaryDirectory() as made:
        (Path(made) / name).write_bytes(content)
        (Path(made) / (name.split(".cpu")[0] + ".meta")).write_bytes(description)
        wp.load_aot_module(module, device="cpu", module_dir=made)


def _made(module: str) -> bytes:
    """The machine code of a module for this core: its file's name, Warp's description of it, and its content."""
    if module == MODULE:
        with suppress(OSError):  # pictures, which most scenes have, will need theirs
            _made_by_another_process(OPTICS)
    with tempfile.TemporaryDirectory() as made, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the code is of this processor alone: so is its key
        (path,) = wp.compile_aot_module(module, device="cpu", module_dir=made)
        description = path.with_name(path.name.split(".cpu")[0] + ".meta")
        return pickle.dumps((path.name, description.read_bytes(), path.read_bytes()))


def _made_by_another_process(module: str) -> None:
    """Have a module compiled meanwhile, where there is a second core; nobody waits for the process that does it."""
    if not hasattr(os, "posix_spawn") or machine.cores() < 2:
        return
    program = f"from tacgen.physics import runtime; runtime.load({module!r}, 'cpu')"
    silent = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in range(3)]
    command = [sys.executable, "-c", program]
    os.posix_spawn(sys.executable, command, machine.environment(), file_actions=silent, setsid=True)


def array(values: Any, dtype: Any) -> wp.array:
    """A view of an array of NumPy, or of a tensor, whose last axes are those of `dtype`."""
    if isinstance(values, np.ndarray):
        view = wp.array(values, dtype=dtype, device="cpu", copy=False)
        assert not values.size or view.ptr == values.ctypes.data, f"{values.dtype} is not what a kernel takes"
        return view
    return wp.from_torch(values, dtype=dtype)


class Launches:
    """Launches on a core, prepared: to prepare one takes longer than to run it on few cells."""

    def __init__(self) -> None:
        self._of_types: dict[tuple[Any, ...], PreparedLaunch] = {}
        self._of_shapes: dict[tuple[Any, ...], Callable[[list[Array]], None]] = {}

    def __call__(self, kernel: wp.Kernel, dim: tuple[int, ...], *values: Any) -> None:
        """As `launch`, on arrays of NumPy, of which only the addresses change.

        Raises ValueError: the last axes of an array are not those of the kernel's type.
        """
        if 0 in dim:
            return
        shapes: list[Any] = [dim]
        types: list[Any] = [kernel]
        rows = []
        for value in values:
            if isinstance(value, np.ndarray):
                row = value if value.flags.c_contiguous else np.ascontiguousarray(value)
                rows.append(row)  # lives until the kernel has run
                shapes.append(row.shape)
                types.append(row.dtype.char)
            else:
                types.append(value)
        of_types = tuple(types)
        asked = of_types, tuple(shapes)
        run = self._of_shapes.get(asked)
        if run is None:
            for kept in (self._of_shapes, self._of_types):
                if len(kept) == MAX_PREPARED_LAUNCHES:
                    del kept[next(iter(kept))]
            if of_types not in self._of_types:
                self._of_types[of_types] = PreparedLaunch(kernel, dim, values)
            run = self._of_shapes[asked] = self._of_types[of_types].fitted(dim, rows)
        run(rows)


class PreparedLaunch:
    """A kernel's launch on a core with arrays of NumPy of certain types, and all else as in `values`."""

    def __init__(self, kernel: wp.Kernel, dim: tuple[int, ...], values: tuple[Any, ...]) -> None:
        values = tuple(np.ascontiguousarray(each) if isinstance(each, np.ndarray) else each for each in values)
        self._recorded = launch(kernel, dim, *values, record=True)
        _, *params = self._recorded.params  # the first parameter is the launch's size
        names = [f"p{k}" for k in range(len(params))]
        fields = [(name, type(param)) for name, param in zip(names, params, strict=True)]
        self._given: Any = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*params)
        arrays = [(name, argument.type.ndim, value)
                  for name, argument, value in zip(names, kernel.adj.args, values, strict=True)
                  if isinstance(value, np.ndarray)]  # fmt: skip
        self._arrays = [(name, axes, value.shape[axes:]) for name, axes, value in arrays]

    def fitted(self, dim: tuple[int, ...], rows: list[Array]) -> Callable[[list[Array]], None]:
        """The launch with arrays of the shapes of these, which it is given when it runs."""
        given = type(self._given).from_buffer_copy(self._given)
        there = [getattr(given, name) for name, _, _ in self._arrays]
        for part, row, (_, axes, last) in zip(there, rows, self._arrays, strict=True):
            if row.shape[axes:] != last:
                raise ValueError(f"an array of shape {row.shape}, where its last axes are {last}")
            part.shape[:axes], part.strides[:axes] = row.shape[:axes], row.strides[:axes]
        self._recorded.set_dim(dim)
        function, arguments = self._recorded.hooks.forward, (ctypes.byref(self._recorded.bounds), ctypes.byref(given))

        def run(rows: list[Array]) -> None:
            for part, row in zip(there, rows, strict=True):
                part.data = _Address.from_address(id(row) + ARRAY_ADDRESS).value
            function(*arguments)

        return run


_threads = threading.local()


def call(kernel: wp.Kernel, dim: tuple[int, ...], *values: Any) -> None:
    """As `launch`, on a core, on arrays of NumPy; launches on arrays of the same types are prepared once."""
    if not hasattr(_threads, "launches"):
        _threads.launches = Launches()
    _threads.launches(kernel, dim, *values)


def launch(kernel: wp.Kernel, dim: tuple[int, ...], *values: Any, record: bool = False) -> Any:
    """Run a kernel on its arguments, the outputs among them: arrays of Warp, NumPy or PyTorch; None is one of no rows.

    On a GPU it runs in PyTorch's stream, and launches on arrays of the same types are prepared once. record: returns
    the launch instead.
    """
    if not record and any(map(on_gpu, values)):
        return _launch_on_gpu(kernel, dim, values)
    kinds = [argument.type for argument in kernel.adj.args]
    found = [
        array(value, kind.dtype) if hasattr(kind, "ndim") and not isinstance(value, wp.array | None) else value
        for kind, value in zip(kinds, values, strict=True)
    ]
    device = next(value.device for value in found if isinstance(value, wp.array))
    inputs = [_none(k.dtype, k.ndim, device.alias) if v is None else v for k, v in zip(kinds, found, strict=True)]
    load(kernel.module.name, device.alias)
    axes = getattr(kernel.adj, "kernel_dim", len(dim))
    assert len(dim) == axes, f"{kernel.key} has threads of {axes} axes, not {len(dim)}"
    threads = MODULE_THREADS.get(kernel.module.name, BLOCK_THREADS)
    return wp.launch(kernel, dim=dim, inputs=inputs, device=device, record_cmd=record, block_dim=threads)


class TensorLaunches:
    """Launches of kernels on tensors, prepared: Warp prepares one for each kernel and types of its arrays, which
    takes a hundred times as long as it runs, and those on arrays of other shapes are copies of it."""

    def __init__(self) -> None:
        self._of_types: dict[tuple[Any, ...], wp.Launch] = {}
        self._of_shapes: dict[tuple[Any, ...], wp.Launch] = {}

    def __call__(self, kernel: wp.Kernel, dim: tuple[int, ...], values: tuple[Any, ...]) -> wp.Launch:
        """The launch on these tensors of one device, arrays of Warp, numbers and vectors.

        Raises ValueError: the last axes of a tensor are not those of the kernel's type.
        """
        key: list[Any] = [kernel, dim]
        for value in values:
            key.append(getattr(value, "dtype", type(value)))
            if hasattr(value, "stride"):
                key += value.shape, value.stride()
            elif hasattr(value, "strides"):
                key += value.shape, value.strides
        asked = tuple(key)
        if (found := self._of_shapes.get(asked)) is None:
            if len(self._of_shapes) == MAX_PREPARED_GPU_LAUNCHES:
                del self._of_shapes[next(iter(self._of_shapes))]
            found = self._of_shapes[asked] = self._fitted(kernel, dim, values)
        params = found.params
        for k, value in enumerate(values, 1):  # before them the launch's size
            if hasattr(value, "data_ptr"):
                params[k].data = value.data_ptr()
            elif isinstance(value, int | float):
                params[k].value = value
            elif isinstance(value, wp.array):
                params[k].data = value.ptr
            elif value is not None:
                found.set_param_at_index(k - 1, value)
        return found

    def _fitted(self, kernel: wp.Kernel, dim: tuple[int, ...], values: tuple[Any, ...]) -> wp.Launch:
        asked = kernel, *(getattr(value, "dtype", type(value)) for value in values)
        if asked not in self._of_types:
            self._of_types[asked] = launch(kernel, dim, *values, record=True)
            self._of_types[asked].fwd_args = None  # the arrays of this call, which need not stay
        made = copy.copy(self._of_types[asked])
        made.params = [made.params[0], *(type(param).from_buffer_copy(param) for param in made.params[1:])]
        if made.params_addr is not None:
            made.params_addr = type(made.params_addr)(*map(ctypes.addressof, made.params))
        made.set_dim(dim)
        for part, argument, value in zip(made.params[1:], kernel.adj.args, values, strict=True):
            if hasattr(value, "shape"):
                axes, strides = argument.type.ndim, getattr(value, "strides", ())
                if hasattr(value, "data_ptr"):
                    last = tuple(value.shape[axes:])
                    if last != getattr(argument.type.dtype, "_shape_", ()) or (last and value.stride(-1) != 1):
                        raise ValueError(f"a tensor of shape {tuple(value.shape)} for {argument.label} of {kernel.key}")
                    strides = [value.element_size() * k for k in value.stride()]
                part.shape[:axes], part.strides[:axes] = value.shape[:axes], strides[:axes]
        return made


def _launch_on_gpu(kernel: wp.Kernel, dim: tuple[int, ...], values: tuple[Any, ...]) -> None:
    import torch

    if 0 in dim:
        return
    device = next(value.get_device() for value in values if hasattr(value, "get_device"))
    if not hasattr(_threads, "on_gpus"):
        _threads.on_gpus = defaultdict(TensorLaunches)  # by the number of the GPU
    prepared = _threads.on_gpus[device](kernel, dim, values)
    # the address of torch.cuda.current_stream(), which takes as long as the launch
    prepared.launch(_stream(torch._C._cuda_getCurrentRawStream(device), prepared.device.alias))


@cache
def _stream(handle: int, device: str) -> wp.Stream:
    """Warp's object for a stream of PyTorch; a new one each time would be registered and removed in recordings."""
    return wp.Stream(device, cuda_stream=handle)


def run(kernel: wp.Kernel, dim: tuple[int, ...], *values: Any) -> None:
    """As `call` on arrays of NumPy, of which the first argument is one, and else as `launch`."""
    (call if isinstance(values[0], np.ndarray) else launch)(kernel, dim, *values)


def empty(like: Any, *shape: int) -> Any:
    """An array of numbers, not filled, of NumPy or of PyTorch as `like` is."""
    return np.empty(shape) if isinstance(like, np.ndarray) else like.new_empty(shape)


def on_gpu(like: Any) -> bool:
    """Whether an array of NumPy or PyTorch is on a GPU."""
    return getattr(like, "is_cuda", False)


def lanes(like: Any, count: int = BLOCK_THREADS) -> int:
    """How many threads share work that one does on a core; those of a block can add what each has found."""
    return count if on_gpu(like) else 1


def room(dtype: Any, shape: tuple[int, ...], like: Any) -> wp.array:
    """An array of a Warp type, not filled, where a tensor is: of PyTorch's memory, which recordings need."""
    if not on_gpu(like):
        return wp.empty(shape, dtype=dtype, device="cpu")
    import torch

    memory = torch.empty(math.prod(shape) * wp.types.type_size_in_bytes(dtype), dtype=torch.uint8, device=like.device)
    held = wp.array(ptr=memory.data_ptr(), dtype=dtype, shape=shape, device=wp.device_from_torch(like.device))
    held.memory = memory  # lives as long
    return held


@cache
def _none(dtype: Any, ndim: int, device: str) -> wp.array:
    return wp.zeros((0,) * ndim, dtype=dtype, device=device)
