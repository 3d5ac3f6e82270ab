"""Without PyTorch, an extra, the batch engine is not tested."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("torch") else ["test_*.py"]
