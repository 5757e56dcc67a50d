"""Recordings for the Rerun viewer, and pictures: the only code that imports rerun or matplotlib."""
