"""The one family of errors that a user can cause and cure.

`InputError`
  +-- `service.bundle.load.BundleError`   a bundle that must not be run
  +-- `service.bus.BusError`         a bus that is not there or cannot be used
  +-- `service.logs.LogError`        a file that is not a log, or a recording that is not whole

`service.cli` prints the message in one line and exits with 2. Trouble with a residual is never an error: it is the
verdict *cannot tell*.
"""


class InputError(Exception):
    """Invalid input of the user: the message names file, place and remedy in one line."""
