"""Bundles: their files, signatures and slots, loading, and a trial run."""
