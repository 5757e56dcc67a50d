"""Where jobs run: here, on all cores, or on a Dask cluster.  Nothing else in fleetlog knows."""

from fleetlog.engines.engine import Engine, current, using

__all__ = ["Engine", "current", "using"]
