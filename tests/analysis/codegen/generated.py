"""Runs generated code: Python in this process, C99 through the system's compiler and a small driver."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from once import once

from faultline.analysis.codegen import Program, c99_sources, class_name, python_source
from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import load_model
from faultline.analysis.recordings.observe import observe, open_known
from faultline.service.core.signals.dbc import compile_dbc

Array = npt.NDArray[np.float64]

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "log"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler `cc` on this machine")


@once
def golden_samples() -> tuple[tuple[str, ...], Array]:
    """The signals of uds (nz,) and the samples (600, nz) of the golden log: filter fA_du clogs at 70 s."""
    bank = build_bank(load_model("uds"))
    log = open_known(GOLDEN, print)
    table = compile_dbc(log.dbc, {channel.signal: channel.unit for channel in bank.inputs}, str(GOLDEN))
    z = np.array([tick.z for tick in observe(bank, log.signals(table))])
    return tuple(channel.signal for channel in bank.inputs), z


def python_class(program: Program) -> Any:
    """The generated class, from its source alone."""
    space: dict[str, Any] = {}
    exec(compile(python_source(program), program.name, "exec"), space)  # noqa: S102  (that is what is tested)
    return space[class_name(program.name)]


def run_python(program: Program, signals: Sequence[str], z: Array) -> Array:
    """Residuals (K,) of the samples `z` (K, nz), with carried state."""
    generator = python_class(program)()
    columns = [signals.index(name) for name in generator.INPUTS]
    return np.array([generator.step(sample) for sample in z[:, columns].tolist()])


def run_c99(programs: Sequence[Program], signals: Sequence[str], z: Array, folder: Path) -> Array:
    """Residuals (K, P) of the compiled programs; the sources are compiled with every warning an error."""
    for program in programs:
        for name, text in c99_sources(program).items():
            (folder / name).write_text(text)
    (folder / "driver.c").write_text(_driver(programs, signals))
    sources = [f"{program.name}.c" for program in programs]
    subprocess.run(["cc", *STRICT, "-o", "driver", "driver.c", *sources, "-lm"], cwd=folder, check=True)
    done = subprocess.run([folder / "driver"], input=np.ascontiguousarray(z).tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(len(z), len(programs))


def _driver(programs: Sequence[Program], signals: Sequence[str]) -> str:
    """Reads samples from standard input and writes residuals, both as doubles."""
    lines = ["#include <stdio.h>", *(f'#include "{p.name}.h"' for p in programs), "int main(void)", "{"]
    lines += [f"    double z[{len(signals)}], r[{len(programs)}];"]
    lines += [f"    {p.name}_state s{k};\n    {p.name}_input u{k};" for k, p in enumerate(programs)]
    lines += [f"    {p.name}_init(&s{k});" for k, p in enumerate(programs)]
    lines += ["    while (fread(z, sizeof z, 1, stdin) == 1) {"]
    for k, p in enumerate(programs):
        lines += [f"        u{k}.{channel.name} = z[{signals.index(channel.signal)}];" for channel in p.inputs]
        lines += [f"        r[{k}] = {p.name}_step(&s{k}, &u{k});"]
    lines += ["        if (fwrite(r, sizeof r, 1, stdout) != 1) return 1;", "    }", "    return 0;", "}"]
    return "\n".join(lines) + "\n"
