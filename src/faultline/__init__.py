"""faultline finds which component of a vehicle subsystem is failing, from the CAN bus.

The packages stand at the top of the repository; this folder links to them, so that all are imported as `faultline.…`.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import ModuleType


class _NoAsammdfForPythonCan(MetaPathFinder):
    """Hides asammdf from python-can, which imports it where it is installed.

    With pandas it takes every command 0.6 s and 120 MB, and only the process that reads an MF4 needs it.
    """

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        """Leave every module to the other finders; raise ModuleNotFoundError for asammdf while python-can asks."""
        del path, target
        if fullname == "asammdf":
            spec = getattr(sys.modules.get("can.io.mf4"), "__spec__", None)
            if getattr(spec, "_initializing", False):
                raise ModuleNotFoundError("No module named 'asammdf'", name="asammdf")


sys.meta_path.insert(0, _NoAsammdfForPythonCan())
