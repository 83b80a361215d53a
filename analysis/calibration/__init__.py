"""Fits the parameters of a model to a fault-free recording."""
