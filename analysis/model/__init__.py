"""A system's model: equations, signals, parameters and faults in one frozen object, and its file format."""

from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.file import load_model, parse_model
from faultline.analysis.model.functions import sgsqrt
from faultline.analysis.model.model import (
    Differential,
    Equation,
    Fault,
    Known,
    Mode,
    Model,
    OperatingModes,
    Parameter,
    Unknown,
)
from faultline.analysis.model.write import dump_model

__all__ = [
    "Differential",
    "Equation",
    "Fault",
    "Known",
    "Mode",
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
