"""Occupancy of floor cells and road stretches, weighted by time."""
