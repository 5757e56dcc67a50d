"""Compiled loops of the simulator; imported only where they run."""
