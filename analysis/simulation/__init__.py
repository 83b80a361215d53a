"""A model run freely: from its inputs alone, with exact derivatives to parameters and inputs."""

from faultline.analysis.simulation.run import Drive, Trajectory, run
from faultline.analysis.simulation.system import System, check_free_run, disturbance, system_of

__all__ = ["Drive", "System", "Trajectory", "check_free_run", "disturbance", "run", "system_of"]
