"""Forms of the state equation for large scenes."""
