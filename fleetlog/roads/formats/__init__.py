"""One file a map format; each holds a ``READER`` (see :mod:`fleetlog.roads.formats.base`)."""
