"""One file an analysis: its options, read, call the library function of the same name, write, say."""
