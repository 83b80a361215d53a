"""Trial of a bundle in a process of its own, with little memory, little time and no rights.

It is loaded, its golden vectors are computed, and decided on. A graph may be signed and still ask for more memory than
there is, or for ever: that ends the trial and nothing else.
"""

import os
import resource
import subprocess
import sys
from pathlib import Path

from faultline.service.core.errors import InputError

MEMORY = 320 << 20  # bytes of data, of which a thread's stack is 8 MiB; the service may have 256 MiB in real memory
CPU_S = 60
NOBODY = 65534
PATIENCE_S = 120.0

_CHILD = "import sys; from faultline.service.bundle.trial import child; sys.exit(child(sys.argv[1]))"


def trial(folder: Path, memory: int = MEMORY, cpu_s: int = CPU_S, patience_s: float = PATIENCE_S) -> None:
    """Tries the bundle in `folder`.

    Raises:
        InputError: it does not load, does not compute what it should, or takes too much.
    """
    words = [sys.executable, "-P", "-c", _CHILD, str(folder.resolve())]
    environment = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(  # noqa: S603 - this interpreter and a folder, without a shell
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            cwd="/",
            env=environment,
            timeout=patience_s,
            check=False,
            preexec_fn=lambda: _limit(memory, cpu_s),
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{folder}: its trial was not done after {patience_s:g} s; do not use it") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        why = said[-1][:500] if said else "it said nothing"
        killed = f"killed by signal {-done.returncode}: " if done.returncode < 0 else ""
        raise InputError(f"{folder}: failed its trial ({memory >> 20} MiB, {cpu_s} s of a processor): {killed}{why}")


def child(folder: str) -> int:
    """Run the trial in the process; returns its exit code."""
    import numpy as np

    from faultline.service.bundle.files import whole
    from faultline.service.bundle.load import Bundle, bundle_of, verify_golden
    from faultline.service.core.decision.decision import Decision
    from faultline.service.core.signals.modes import ModeTracker

    def decides(bundle: Bundle) -> None:
        manifest, bank = bundle.manifest, bundle.bank()
        tracker, decision = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s), Decision(manifest)
        usable = np.ones(len(manifest.inputs), dtype=np.bool_)
        for tick, z in enumerate(map(np.array, bundle.golden.z)):
            decision.update(tick, tracker.update(z, usable), bank.step(z, usable))

    try:
        given = whole(Path(folder))
        _give_up_rights()
        bundle = bundle_of(given, Path(folder))
        verify_golden(bundle)
        decides(bundle)
    except (InputError, MemoryError) as error:
        print(" ".join(str(error).split()) or "too little memory", file=sys.stderr)
        return 1
    return 0


def _give_up_rights() -> None:
    """Drop root's rights, once all files have been read."""
    if os.geteuid() == 0:
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)


def _limit(memory: int, cpu_s: int) -> None:
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
