"""What the functions of the library have in common: arguments, inputs, results."""
