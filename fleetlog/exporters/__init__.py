"""One file a format: a trajectory dataset to the tables, tracks and networks that other tools read."""
