"""Compiled loops: grouping, distances, decoding, routes, placing."""
