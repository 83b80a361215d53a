"""The model with what was found: whether it may be taken, and what changes by it."""
