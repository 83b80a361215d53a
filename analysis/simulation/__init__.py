"""A model run freely: from its inputs alone, with exact derivatives to parameters and inputs."""

from analysis.simulation.run import Drive, Trajectory, run
from analysis.simulation.system import System, disturbance, system_of

__all__ = ["Drive", "System", "Trajectory", "disturbance", "run", "system_of"]
