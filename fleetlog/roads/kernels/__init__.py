"""Compiled loops: distances, decoding, routes."""
