"""Residual generators as code to read: computation sequences with their causality, as Python and as C99."""

from faultline.analysis.codegen.build import residual_program
from faultline.analysis.codegen.c99 import c99_sources
from faultline.analysis.codegen.identifiers import class_name
from faultline.analysis.codegen.program import Program
from faultline.analysis.codegen.python import python_source
from faultline.analysis.codegen.sequence import Component, ComputationSequence, computation_sequence

__all__ = [
    "Component",
    "ComputationSequence",
    "Program",
    "c99_sources",
    "class_name",
    "computation_sequence",
    "python_source",
    "residual_program",
]
