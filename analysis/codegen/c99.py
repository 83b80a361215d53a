"""Writes a residual generator as C99 that needs nothing but math.h: a struct for the state, `init` and `step`."""

from collections.abc import Iterator

from faultline.analysis.codegen.helpers import Helper, helpers_in
from faultline.analysis.codegen.identifiers import words_in
from faultline.analysis.codegen.program import Program
from faultline.analysis.codegen.text import number


def c99_sources(program: Program) -> dict[str, str]:
    """Header and source by file name; the source compiles alone, without a warning.

    `NAME_init` makes a state of which nothing is known; `NAME_step` takes a sample and gives the residual.
    """
    return {f"{program.name}.h": _header(program), f"{program.name}.c": _source(program)}


def _header(program: Program) -> str:
    name = program.name
    guard = f"{name.upper()}_H"
    members = [f"    double {s.name}; {_comment(s.note)}" for s in program.states]
    signals = [f"    double {channel.name}; {_comment(channel.note)}" for channel in program.inputs]
    lines = [_comment(note) for note in program.notes]
    lines += ["", f"#ifndef {guard}", f"#define {guard}", ""]
    lines += [_comment("One sample."), "typedef struct {", *signals, f"}} {name}_input;", ""]
    lines += [_comment("What is carried from step to step; NaN where it is not known.")]
    lines += ["typedef struct {", *(members or ["    char nothing;"]), f"}} {name}_state;", ""]
    lines += [f"void {name}_init({name}_state *s);", ""]
    lines += [_comment(f"The residual [{program.unit}] of the sample u.")]
    lines += [f"double {name}_step({name}_state *s, const {name}_input *u);", "", "#endif"]
    return "\n".join(lines) + "\n"


def _source(program: Program) -> str:
    name = program.name
    lines = [_comment(note) for note in program.notes]
    lines += ["", f'#include "{name}.h"', "", "#include <math.h>", ""]
    lines += [f"static const double {c.name} = {number(c.value)}; {_comment(c.note)}" for c in program.constants]
    for helper, function in helpers_in([*(line.text for line in program.lines), program.residual]).items():
        lines += ["", *_function(helper, function)]
    lines += ["", f"void {name}_init({name}_state *s)", "{"]
    lines += [f"    s->{state.name} = NAN;" for state in program.states] or ["    s->nothing = 0;"]
    lines += ["}", "", f"double {name}_step({name}_state *s, const {name}_input *u)", "{"]
    lines += _body(program)
    return "\n".join([*lines, "}"]) + "\n"


def _body(program: Program) -> Iterator[str]:
    used = _words(program)
    for channel in program.inputs:
        if channel.name in used:
            yield f"    const double {channel.name} = u->{channel.name};"
    for state in program.states:
        yield f"    const double {state.name} = s->{state.name};"
    targets = [line.target for line in program.lines]
    declared: set[str] = set()
    for line in program.lines:
        kind = "" if line.target in declared else "double " if targets.count(line.target) > 1 else "const double "
        declared.add(line.target)
        note = f" {_comment(line.note)}" if line.note else ""
        yield f"    {kind}{line.target} = {line.text};{note}"
    for state in program.states:
        yield f"    s->{state.name} = {state.next};"
    if not program.states:
        yield "    (void)s;"
    yield f"    return {program.residual};"


def _words(program: Program) -> set[str]:
    texts = [*(line.text for line in program.lines), program.residual, *(state.next for state in program.states)]
    return set().union(*map(words_in, texts))


def _function(name: str, helper: Helper) -> Iterator[str]:
    yield _comment(helper.note)
    yield f"static double {name}({', '.join(f'double {argument}' for argument in helper.arguments)})"
    yield "{"
    if helper.c99:
        yield f"    return {helper.c99};"
    else:  # several statements, which only assign: the same text in both languages
        for statement in helper.python:
            yield f"    {statement};" if statement.startswith("return") else f"    const double {statement};"
    yield "}"


def _comment(text: str) -> str:
    """Free text of a model that can neither end a comment nor begin one, a trigraph or a continued line."""
    line = " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("\\", "/")
    return f"/* {line} */"
