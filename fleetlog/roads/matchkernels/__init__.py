"""The inner loops of map matching, in numba; imported only when a track is matched."""
