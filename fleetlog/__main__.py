"""``python -m fleetlog``."""

from fleetlog.cli.main import entry

entry()
