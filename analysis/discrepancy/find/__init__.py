"""Whether something is missing, where in the model, and where in the operating space."""
