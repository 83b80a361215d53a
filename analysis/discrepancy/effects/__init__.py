"""Physical effects as data: the library, and how an effect is written into a model."""
