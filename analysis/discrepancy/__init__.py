"""What a model misses: where, what it may be, and the model with it."""
