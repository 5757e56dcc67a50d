"""Loops that numpy cannot express."""
