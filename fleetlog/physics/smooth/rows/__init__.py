"""Loops over rows that need no smoother."""
