"""The recording in memory: vehicle-days as finely stepped motion, windows, and what is held out."""
