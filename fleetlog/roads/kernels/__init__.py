"""Compiled loops: grouping, candidates, distances, decoding, routes, placing."""
