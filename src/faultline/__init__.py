"""faultline finds which component of a vehicle subsystem is failing, from the CAN bus.

The packages stand at the top of the repository; this folder links to them, so that all are imported as `faultline.…`.
"""
