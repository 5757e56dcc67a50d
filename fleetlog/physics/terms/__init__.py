"""One file a term, which is a plain function of motion and truck; see :mod:`fleetlog.physics.term`."""
