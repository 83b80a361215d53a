"""What an engineer runs offline: from a model and recordings to the bundle that the vehicle runs."""
