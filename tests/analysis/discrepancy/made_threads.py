"""What a worker can be asked without importing anything that has threads of its own."""

from pathlib import Path

import numpy as np


def threads() -> int:
    """Of this process, once it has multiplied."""
    square = np.ones((600, 600))
    assert (square @ square)[0, 0] == 600.0
    return len([*Path("/proc/self/task").iterdir()])
