"""One file a term, a function of motion and truck (:mod:`fleetlog.physics.term`); others in plain.toml."""
