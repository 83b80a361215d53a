"""The error of this package, in a module of its own because all others raise it."""

from faultline.service.core.errors import InputError


class ModelError(InputError):
    """A model file, or a change to a model, that means nothing; the message names file, place and remedy."""
