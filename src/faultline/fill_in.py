"""Places that a first draft leaves to its author: texts that begin with a mark, found by where they stand."""

from collections.abc import Iterator, Mapping, Sequence

MARK = "FILL IN"


def unfilled(value: object, path: str = "") -> Iterator[str]:
    """The places, in tables and lists of TOML, that still have the mark.

    >>> list(unfilled({"name": "x", "known": {"u": {"unit": "FILL IN"}}, "equation": [{"expr": "FILL IN: y - h"}]}))
    ['known.u.unit', 'equation[0].expr']
    """
    if isinstance(value, str):
        if value.startswith(MARK):
            yield path
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from unfilled(each, f"{path}.{key}" if path else str(key))
    elif isinstance(value, Sequence):
        for k, each in enumerate(value):
            yield from unfilled(each, f"{path}[{k}]")
