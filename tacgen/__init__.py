"""tacgen: declarative recipes in, labelled datasets of vision-based tactile sensors out."""

import os

__version__ = "0.1.0"

if os.environ.get("NUMBA_NUM_THREADS") == "0":  # Numba would not be imported
    os.environ["NUMBA_NUM_THREADS"] = "1"
