"""What a set of tests tells apart: fault signature matrix, detectability, isolability."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.structure.supports import Support


def signature_matrix(tests: Sequence[Support], faults: Sequence[str]) -> npt.NDArray[np.bool_]:
    """The fault signature matrix (tests, faults): True where the test is structurally sensitive to the fault."""
    return np.array([[fault in test.faults for fault in faults] for test in tests], dtype=np.bool_).reshape(
        len(tests), len(faults)
    )


def detectable(tests: Sequence[Support], faults: Sequence[str]) -> tuple[str, ...]:
    """The faults that at least one test is sensitive to, in order."""
    return tuple(fault for fault in faults if any(fault in test.faults for test in tests))


def isolability(tests: Sequence[Support], faults: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """For every fault the others that it is not isolable from, in order; a fault that is not detectable has them all.

    A fault is isolable from another if a test is sensitive to it and not to the other (Frisk et al. 2012); the relation
    need not be symmetric.
    """
    signature = signature_matrix(tests, faults)  # (T, F)
    isolable = np.any(signature[:, :, None] & ~signature[:, None, :], axis=0, keepdims=True)[0]  # (F, F)
    return {
        fault: tuple(other for j, other in enumerate(faults) if i != j and not isolable[i, j])
        for i, fault in enumerate(faults)
    }
