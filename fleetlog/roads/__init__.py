"""One file a map format: map to network; matching and routing on it."""
