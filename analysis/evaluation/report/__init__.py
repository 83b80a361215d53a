"""The report on a bundle: one page with its pictures inside, and the same as data."""
