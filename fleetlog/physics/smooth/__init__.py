"""Smooth motion from noisy logs: the path coordinate, a fixed-interval smoother, the other channels."""
