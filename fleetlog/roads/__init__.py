"""Roads: maps to networks, matching and routing on them."""

from fleetlog.roads.load import load_site, read_map

__all__ = ["load_site", "read_map"]
