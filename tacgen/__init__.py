"""tacgen: declarative recipes in, labelled datasets of vision-based tactile sensors out."""

import os

__version__ = "0.1.0"

_threads = os.environ.get("NUMBA_NUM_THREADS", "1")
if not (_threads.isdecimal() and int(_threads)):  # Numba would not be imported, or print a traceback
    os.environ["NUMBA_NUM_THREADS"] = "1"
