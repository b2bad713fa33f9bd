"""Controllers and what they are made of."""
