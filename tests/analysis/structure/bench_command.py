"""`faultline structure` on models of 100, 300 and 600 equations: `make bench` prints the table that docs/results has.

Models are chains of tanks with formulas, units and faults. Sparse: five levels are measured, whatever the length.
Dense: every level is, so the redundancy is the number of tanks, and nobody can list all tests.
Times are CPU times of whole processes, medians of the runs with their range.
"""

import statistics
import subprocess
import sys
import tempfile
from collections.abc import Collection

ROUNDS = 3
SIZES = (100, 300, 600)
FAULTLINE = "import sys; from faultline.service.cli import main; sys.exit(main())"
MEASURED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
counts = next((line for line in done.stdout.splitlines() if "MSO sets" in line), f"ended with {done.returncode}")
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, counts, sep="|")
"""


def main() -> None:
    """Prints the table."""
    print("| model | equations | found | CPU time [s] | memory [MB] |\n|---|---|---|---|---|")
    for size in SIZES:
        dense = (size - 1) // 4
        sparse = (size - 6) // 3
        for kind, tanks, measured in (
            ("sparse", sparse, [round(k * sparse / 5) for k in range(1, 6)]),
            ("dense", dense, range(1, dense + 1)),
        ):
            faulty = range(1 if kind == "dense" else 10, tanks + 1, 1 if kind == "dense" else 10)
            text = chain(tanks, measured, faulty)
            runs = [run(text) for _ in range(ROUNDS)]
            seconds, memory = ([float(one[k]) for one in runs] for k in (0, 1))
            equations = text.count("[[equation]]") + text.count("[[differential]]")
            found = runs[0][2].partition(" tests")[0] + " tests"
            print(f"| {kind} | {equations} | {found} | {spread(seconds)} | {max(memory):.0f} |", flush=True)


def run(text: str) -> list[str]:
    """CPU time [s], memory [MB] and what was found, of one run on the model."""
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(text)
        file.flush()
        command = [sys.executable, "-c", FAULTLINE, "structure", file.name]
        done = subprocess.run([sys.executable, "-c", MEASURED, *command], stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.strip().split("|")


def chain(tanks: int, measured: Collection[int], faulty: Collection[int]) -> str:
    """A model file: tanks in a row, filled by a pump; some levels are measured, some pipes and tanks have faults."""
    signal = 'unit = "m"\ndescription = "level"\nmin = 0.0\nmax = 1.2\nnoise = 1e-3\n'
    text = 'schema = 1\nname = "chain"\nwarm_up_s = 150.0\n'
    text += '[known.u]\nunit = "1"\ndescription = "pump"\nmin = 0.0\nmax = 1.0\nnoise = 1e-3\n'
    text += "".join(f"[known.y{k}]\n{signal}" for k in measured)
    text += "".join(f'[unknown.q{k}]\nunit = "m3/s"\n' for k in range(tanks + 1))
    for name, unit, value in (("k_pump", "m3/s", 2e-4), ("S", "m2", 2e-3), ("g", "m/s2", 9.81), ("h_0", "m", 0.3)):
        text += f'[parameter.{name}]\nunit = "{unit}"\nvalue = {value}\nsource = "made"\n'
    equations = [("q0 - k_pump*u", "")]
    for k in range(1, tanks + 1):
        text += f'[unknown.h{k}]\nunit = "m"\ninitial = ["h_0"]\n[unknown.dh{k}]\nunit = "m/s"\n'
        text += f'[parameter.A{k}]\nunit = "m2"\nvalue = 6e-5\nsource = "made"\n'
        drop = f"h{k} - h{k + 1}" if k < tanks else f"h{k}"
        equations.append((f"q{k} - A{k}*sgsqrt(2*g*({drop}))", f"A{k}" if k in faulty else ""))
        equations.append((f"S*dh{k} - (q{k - 1} - q{k})", f"q{k}" if k in faulty else ""))
        if k in measured:
            equations.append((f"y{k} - h{k}", f"h{k}"))
    for number, (formula, enters) in enumerate(equations):
        text += f'[[equation]]\nname = "e{number:03d}"\nexpr = "{formula}"\n'
        if enters:
            text += f'fault = {{name = "f{number}", component = "part {number}", '
            text += f'enters = "{enters} -> {enters} + f{number}", sizes = [0.1]}}\n'
    for k in range(1, tanks + 1):
        text += f'[[differential]]\nname = "e{len(equations) + k:03d}"\nstate = "h{k}"\nderivative = "dh{k}"\n'
    return text


def spread(values: list[float]) -> str:
    """Median and range."""
    return f"{statistics.median(values):.1f} [{min(values):.1f} .. {max(values):.1f}]"


if __name__ == "__main__":
    main()
