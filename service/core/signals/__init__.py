"""Signals: frames decoded to values with their quality, sampled at the ticks; the operating mode."""
