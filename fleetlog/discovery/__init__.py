"""When model and recording differ: locate it, name what was left out, model it, show the fit improve."""
