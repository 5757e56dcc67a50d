"""The books of energy: sums by trip, hour, stretch and zone, and what they show."""
