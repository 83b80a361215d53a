"""Detectors: a standardised residual in, an alarm out, one tick at a time and in constant memory."""
