"""The installed distribution, by its name on the public index: `faultline` alone is somebody else's there."""

from importlib.metadata import PackageNotFoundError, version

NAME = "faultline-diagnosis"


def install_command(extra: str) -> str:
    """Return the command that installs an extra.

    >>> install_command("web")
    "pip install 'faultline-diagnosis[web]'"
    """
    return f"pip install '{NAME}[{extra}]'"


def installed_version() -> str:
    """Return the version of what is installed; "unknown" in a checkout that is not."""
    try:
        return version(NAME)
    except PackageNotFoundError:
        return "unknown"
