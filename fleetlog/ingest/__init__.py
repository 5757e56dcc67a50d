"""From raw logs to a dataset: clean, derive, match, cut into trips."""
