"""fleetlog: replay, simulate and explain the logs of electric vehicle fleets in a plant."""

__version__ = "0.1.0"
FORMAT_VERSION = 1
