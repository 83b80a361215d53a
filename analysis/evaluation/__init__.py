"""Compares diagnoses with the truth, and draws the story of a recording."""
