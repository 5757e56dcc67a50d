"""Where jobs run: here, on all cores, or on a Dask cluster.  Nothing else in fleetlog knows."""

from fleetlog.engines.current import current, using
from fleetlog.engines.engine import Engine, Serial

__all__ = ["Engine", "Serial", "current", "using"]
