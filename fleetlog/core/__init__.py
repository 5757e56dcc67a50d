"""What the data is: columns, trajectories, trucks, sites, networks, motion, results.
No file format, no drawing.
"""
