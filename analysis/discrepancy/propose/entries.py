"""Proposed terms as a library file: each a whole entry that is reviewed and given back with `--library`."""

from collections.abc import Iterator, Mapping, Sequence

from faultline.analysis.discrepancy.propose.candidates import Candidate
from faultline.analysis.model.write import pairs

HEAD = """schema = 1

# Terms that `faultline discover` has composed and fitted to recordings: formulas, no known physics. Review them. Keep
# what means something, give it a name, a statement and a source, and call again with --library and this file. For model
# {model} the first {count} {verb} proposed; what follows is what the data cannot tell from {them}.
"""


def entries_toml(model: str, terms: Sequence[Candidate], rivals: Sequence[Candidate]) -> str:
    """Return the file's text."""
    one = len(terms) == 1
    head = HEAD.format(count="term" if one else f"{len(terms)} terms", model=model, verb="is" if one else "are",
                       them="it" if one else "them")  # fmt: skip
    return "\n".join([head, *(block for candidate in (*terms, *rivals) for block in _blocks(candidate.table))])


def _blocks(table: Mapping[str, object]) -> Iterator[str]:
    yield "[[effect]]\n" + pairs({key: value for key, value in table.items() if isinstance(value, str)})
    for key, value in table.items():
        if isinstance(value, Mapping):
            for own, part in value.items():
                yield f"[effect.{key}.{own}]\n" + pairs(part)
        elif not isinstance(value, str) and isinstance(value, Sequence):
            for part in value:
                yield f"[[effect.{key}]]\n" + pairs(part)
