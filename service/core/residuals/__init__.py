"""Residuals of a bundle at every tick: the graphs, and what they are given."""
