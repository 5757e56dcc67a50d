"""A fleet in silico."""
