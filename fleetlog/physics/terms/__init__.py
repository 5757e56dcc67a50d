"""One file a term.  A term is a plain function of the motion and the truck;
see :mod:`fleetlog.physics.term`.
"""
