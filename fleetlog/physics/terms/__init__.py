"""Terms: those of fleetlog in terms.toml; one of a user's own is a file with an object ``TERM``."""
