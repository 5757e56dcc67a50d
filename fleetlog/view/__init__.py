"""Everything that a person looks at: recordings for the Rerun viewer, pictures.
The only code that imports rerun or matplotlib.
"""
