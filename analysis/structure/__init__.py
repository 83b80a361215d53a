"""Structural analysis: which equations make a test, what it is sensitive to, and how it can be computed."""

from analysis.structure.arguments import Arguments, Computation, arguments
from analysis.structure.isolability import detectable, isolability, signature_matrix
from analysis.structure.structure import Structure, over_determined, redundancy, structure_of
from analysis.structure.supports import Support, Test, find_tests, integral_tests, mso_sets, mtes_sets

__all__ = [
    "Arguments",
    "Computation",
    "Structure",
    "Support",
    "Test",
    "arguments",
    "detectable",
    "find_tests",
    "integral_tests",
    "isolability",
    "mso_sets",
    "mtes_sets",
    "over_determined",
    "redundancy",
    "signature_matrix",
    "structure_of",
]
