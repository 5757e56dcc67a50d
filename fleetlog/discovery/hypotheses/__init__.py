"""What may have been left out: terms with numbers or places, and free curves that keep them honest."""
