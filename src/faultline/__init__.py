"""faultline finds which component of a vehicle subsystem is failing, from the CAN bus.

The packages stand at the top of the repository; this folder links to them, so that all are imported as `faultline.…`.
"""

import sys
from importlib.util import find_spec


def _import_can_without_asammdf() -> None:
    """Import python-can, which imports asammdf where that is installed, without it.

    With pandas it takes every command 0.6 s and 140 MB, and only the process that reads an MF4 needs it.
    """
    modules: dict[str, object] = sys.modules  # type: ignore[assignment]
    modules["asammdf"] = None  # as if it were not installed
    try:
        import can  # noqa: F401
    finally:
        del modules["asammdf"]


if not {"asammdf", "can"} & sys.modules.keys() and find_spec("asammdf") is not None:
    _import_can_without_asammdf()
