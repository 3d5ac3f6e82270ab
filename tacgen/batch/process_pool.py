"""Processes that start at once, from a common one where imports take long, and end with the one that started them."""

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import connection, forkserver, get_context, parent_process
from threading import Thread


def import_once(module: str) -> None:
    """Begin to import a module in the process that those started by "forkserver" are forked from: PyTorch takes each
    other one four seconds of a core, and 300 MB."""
    get_context("forkserver").set_forkserver_preload([module])
    forkserver.ensure_running()


def started(
    stack: ExitStack, count: int, first: Callable[..., object], *args: object, by: str = "spawn"
) -> ProcessPoolExecutor:
    """So many processes, which are started now and call a function first; they end with this one, if it is killed."""
    pool = stack.enter_context(ProcessPoolExecutor(count, get_context(by), _end_with_parent))
    for _ in range(count):
        pool.submit(first, *args)
    return pool


def _end_with_parent() -> None:
    """End this process when its parent ends: a pool's processes wait forever for one that was killed, with all that
    they hold of a GPU's memory."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    Thread(target=watch, daemon=True).start()
