"""The verdict, in figures, in words, and as files."""
