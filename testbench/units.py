"""Units and the one pressure that surrounds everything."""

ATMOSPHERE = 101_325.0  # Pa, ISO 2533; tank and exhaust are vented to it
BAR = 1e5  # Pa
MBAR = 100.0  # Pa
ML = 1e-6  # m^3
