"""Figures of every test: what the tables of a report are made of, in pictures."""
