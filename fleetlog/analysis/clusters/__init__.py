"""Clusters of trucks that are close along the roads:
the graph at every time step, and clusters followed over time.
"""
