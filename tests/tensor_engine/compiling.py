"""Kernels that tests interpret are compiled for a GPU too, which needs none: what Triton's interpreter takes as Python,
its compiler may refuse."""

import inspect
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import torch

Signature = tuple[str, str, tuple[tuple[str, Any], ...], tuple[tuple[str, Any], ...], int]
POINTERS = {torch.float32: "*fp32", torch.float64: "*fp64", torch.int64: "*i64", torch.int32: "*i32"}
POINTERS |= {torch.bool: "*i1", torch.int8: "*i8", torch.uint8: "*u8", torch.int16: "*i16"}
COMPILED: set[Signature] = set()  # in this process
COMPILER = """
import importlib, json, sys, traceback, triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

def typed(kind):
    return tuple(map(typed, kind)) if isinstance(kind, list) else kind

for line in sys.stdin:
    module, name, arguments, constants, warps = json.loads(line)
    constants = dict(constants)
    signature = {key: "constexpr" if key in constants else typed(kind) for key, kind in arguments}
    try:
        kernel = getattr(importlib.import_module(module), name)
        source = ASTSource(kernel, signature, constants)
        triton.compile(source, target=GPUTarget("cuda", 90, 32), options={"num_warps": warps})
        print(json.dumps(""), flush=True)
    except Exception:
        print(json.dumps(traceback.format_exc()), flush=True)
"""
_compiler: subprocess.Popen[str] | None = None


@contextmanager
def interpreted_and_compiled(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Without a GPU, kernels are interpreted in here, and then compiled.

    Loops go to numbers that the interpreter has as arrays of one, which NumPy 2.4 no longer takes as indices.
    """
    from triton.runtime import interpreter

    if torch.cuda.is_available():
        yield
        return

    def number(end: object) -> int:
        return int(np.ravel(getattr(getattr(end, "handle", end), "data", end))[0])

    monkeypatch.setattr(interpreter, "range", lambda *ends: range(*map(number, ends)), raising=False)
    with compiled():
        yield


@contextmanager
def compiled() -> Iterator[None]:
    """Afterwards kernels that were interpreted in here are compiled. Raises AssertionError: one cannot be."""
    from triton.runtime.interpreter import GridExecutor

    seen, call = set[Signature](), GridExecutor.__call__

    def noted(self: Any, *given: Any, **more: Any) -> None:
        seen.add(signature(self.fn, given, more))
        call(self, *given, **more)

    GridExecutor.__call__ = noted
    try:
        yield
    finally:
        GridExecutor.__call__ = call
    for each in sorted(seen - COMPILED, key=str):
        COMPILED.add(each)
        assert (why := _compile(each)) == "", f"{each}: {why}"


def signature(function: Any, given: Any, more: dict[str, Any]) -> Signature:
    """What a kernel is compiled for: types of its arguments, and its constants."""
    parameters = inspect.signature(function).parameters
    own = {key: value for key, value in more.items() if key in parameters}
    arguments = inspect.signature(function).bind(*given, **own).arguments
    constants = [key for key in arguments if "constexpr" in str(parameters[key].annotation)]
    kinds = tuple((key, None if key in constants else _kind(value)) for key, value in arguments.items())
    values = tuple((key, arguments[key]) for key in constants)
    return function.__module__, function.__name__, kinds, values, more.get("num_warps", 4)


def _kind(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return tuple(map(_kind, value))
    if isinstance(value, torch.Tensor):
        return POINTERS[value.dtype]
    return "fp32" if isinstance(value, float) else "i32"


def _compile(each: Signature) -> str:
    """Why a kernel cannot be compiled, by a process whose kernels are not those of the interpreter."""
    global _compiler
    if _compiler is None:
        there = {key: value for key, value in os.environ.items() if key != "TRITON_INTERPRET"}
        command = [sys.executable, "-c", COMPILER]
        _compiler = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=there)
    assert _compiler.stdin is not None
    assert _compiler.stdout is not None
    print(json.dumps(each), file=_compiler.stdin, flush=True)
    why: str = json.loads(_compiler.stdout.readline())
    return why
