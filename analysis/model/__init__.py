"""A system's model: equations, signals, parameters and faults in one frozen object, and its file format."""

from analysis.model.errors import ModelError
from analysis.model.expression import sgsqrt
from analysis.model.file import load_model, parse_model
from analysis.model.model import Differential, Equation, Fault, Known, Model, OperatingModes, Parameter, Unknown
from analysis.model.write import dump_model

__all__ = [
    "Differential",
    "Equation",
    "Fault",
    "Known",
    "Model",
    "ModelError",
    "OperatingModes",
    "Parameter",
    "Unknown",
    "dump_model",
    "load_model",
    "parse_model",
    "sgsqrt",
]
