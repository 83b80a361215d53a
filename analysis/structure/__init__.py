"""Structural analysis: which equations make a test, what it is sensitive to, and how it can be computed."""

from faultline.analysis.structure.arguments import Arguments, Computation, arguments
from faultline.analysis.structure.causality import residual_causality
from faultline.analysis.structure.decomposition import dulmage_mendelsohn
from faultline.analysis.structure.diagnosability import detectability, isolability_of
from faultline.analysis.structure.explain import why
from faultline.analysis.structure.index import differential_orders, low_index, observable
from faultline.analysis.structure.isolability import detectable, isolability, signature_matrix
from faultline.analysis.structure.lint import lint, lint_structure, sound_model
from faultline.analysis.structure.matrix import read_structure, structural_model
from faultline.analysis.structure.placement import place_sensors
from faultline.analysis.structure.selection import select_tests
from faultline.analysis.structure.sensors import add_sensors, drop_sensors, with_other_sensors
from faultline.analysis.structure.structure import Structure, over_determined, redundancy, structure_of
from faultline.analysis.structure.supports import Support, Test, find_tests, integral_tests, mso_sets, mtes_sets

__all__ = [
    "Arguments",
    "Computation",
    "Structure",
    "Support",
    "Test",
    "add_sensors",
    "arguments",
    "detectability",
    "detectable",
    "differential_orders",
    "drop_sensors",
    "dulmage_mendelsohn",
    "find_tests",
    "integral_tests",
    "isolability",
    "isolability_of",
    "lint",
    "lint_structure",
    "low_index",
    "mso_sets",
    "mtes_sets",
    "observable",
    "over_determined",
    "place_sensors",
    "read_structure",
    "redundancy",
    "residual_causality",
    "select_tests",
    "signature_matrix",
    "sound_model",
    "structural_model",
    "structure_of",
    "why",
    "with_other_sensors",
]
