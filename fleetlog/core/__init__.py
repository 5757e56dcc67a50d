"""What the data is: columns, trajectories, trucks, sites, networks, results; no file format, no drawing."""
