"""What a recording shows and a model predicts: energy over windows, travel time over stretches of path."""
