"""Datasets on disk: written whole or not at all, read by vehicle and day, with provenance."""

from fleetlog.store.dataset import Dataset
from fleetlog.store.writer import DatasetWriter

__all__ = ["Dataset", "DatasetWriter"]
