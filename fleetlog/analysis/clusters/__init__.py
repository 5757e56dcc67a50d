"""Clusters of trucks that are close along the roads: at every time step, and followed over time."""
