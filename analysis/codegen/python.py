"""Writes a residual generator as a Python module that needs nothing but the standard library."""

from faultline.analysis.codegen.helpers import LIBRARY, helpers_in
from faultline.analysis.codegen.identifiers import class_name, words_in
from faultline.analysis.codegen.program import Program
from faultline.analysis.codegen.text import number


def python_source(program: Program) -> str:
    """A module with one class, of the program's name in capitals: `Residual().step(u)` gives the residual.

    `u` is a sequence of the signals in the order of `INPUTS`.
    """
    texts = [*(line.text for line in program.lines), program.residual]
    helpers = helpers_in(texts)
    used = words_in("\n".join([*texts, *("\n".join(h.python) for h in helpers.values())]))
    imports = sorted(({*LIBRARY, "inf"} & used) | {"nan"})
    lines = [*(f"# {note}" for note in program.notes), "", f"from math import {', '.join(imports)}", ""]
    lines += [f"{c.name} = {number(c.value)}  # {_comment(c.note)}" for c in program.constants]
    for name, helper in helpers.items():
        lines += [
            "",
            "",
            f"def {name}({', '.join(helper.arguments)}):",
            f'    """{helper.note[:1].upper()}{helper.note[1:]}."""',
        ]
        lines += [f"    {statement}" for statement in helper.python]
    lines += ["", "", f"class {class_name(program.name)}:"]
    lines += ['    """A residual generator: one `step` a sample."""', "", "    INPUTS = ("]
    lines += [f'        "{channel.signal}",  # {_comment(channel.note)}' for channel in program.inputs]
    lines += ["    )", "", "    def __init__(self):"]
    lines += ['        """Nothing is known of the past yet."""']
    lines += [f"        self.{state.name} = nan  # {_comment(state.note)}" for state in program.states]
    lines += ["", "    def step(self, u):"]
    lines += [
        f'        """The residual [{_comment(program.unit)}] of a sample: its signals in the order of `INPUTS`."""'
    ]
    names = ", ".join(channel.name for channel in program.inputs)
    lines.append(f"        {names} = u" if len(program.inputs) > 1 else f"        [{names}] = u")
    lines += [f"        {state.name} = self.{state.name}" for state in program.states]
    for line in program.lines:
        lines.append(f"        {line.target} = {line.text}" + (f"  # {_comment(line.note)}" if line.note else ""))
    lines += [f"        self.{state.name} = {state.next}" for state in program.states]
    lines.append(f"        return {program.residual}")
    return "\n".join(lines) + "\n"


def _comment(text: str) -> str:
    """Free text of a model that cannot end a comment or a docstring."""
    return " ".join(text.split()).replace("\\", "/").replace('"', "'")
