"""The threshold test whose threshold follows the spread that a generator expects at this tick.

The threshold moves with the operating mode and with the generator's own sigma: J * scale_m * sigma / usual_m. Moving
the threshold is dividing the residual by what moves it, which `service.core.detectors.standard` does; what remains is
the threshold test itself. Without a sigma of its own (the equations') a generator has the plain threshold test.
"""

from faultline.service.core.detectors.threshold import Threshold


class Adaptive(Threshold):
    """A threshold test that is fed with the residual in parts of the tick's own spread."""
