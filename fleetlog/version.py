"""The version of fleetlog, and of the format of its datasets."""

__version__ = "0.1.0"
FORMAT_VERSION = 1
