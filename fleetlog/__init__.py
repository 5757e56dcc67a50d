"""fleetlog: replay, simulate and explain the logs of electric forklift and AGV fleets.

Every command is a function here, with the same arguments; files may be paths or objects, logs and tables
DataFrames, and a result has ``tables``, ``summary``, ``save()``, ``show()`` and an HTML form for notebooks:

    import fleetlog

    recorded = fleetlog.read_logs("logs/", site="site.toml")
    fleetlog.analyze.density(recorded, threshold=20.0).show()
    fleetlog.diagnose(recorded, truck="truck.toml").save("diagnosis")

Nothing is imported before it is used."""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from fleetlog.version import FORMAT_VERSION, __version__

if TYPE_CHECKING:
    from fleetlog.api.answer import Answer as Result
    from fleetlog.api.inputs import as_dataset as open
    from fleetlog.core.trajectory import Trajectory
    from fleetlog.errors import FleetlogError
    from fleetlog.store import Dataset
    from fleetlog.verbs.analyze import analyze
    from fleetlog.verbs.calibrate import calibrate
    from fleetlog.verbs.demo import demo
    from fleetlog.verbs.diagnose import diagnose
    from fleetlog.verbs.export import export
    from fleetlog.verbs.import_ import import_
    from fleetlog.verbs.import_ import import_ as read_logs
    from fleetlog.verbs.info import info
    from fleetlog.verbs.learn import learn
    from fleetlog.verbs.record import record
    from fleetlog.verbs.report import report
    from fleetlog.verbs.simulate import simulate
    from fleetlog.verbs.view import view

NAMES = {  # What is offered beside the verbs, and where it is
    "read_logs": "verbs.import_:import_", "Result": "api.answer:Answer", "open": "api.inputs:as_dataset",
    "Dataset": "store:Dataset", "FleetlogError": "errors:FleetlogError",
    "Trajectory": "core.trajectory:Trajectory",
}  # fmt: skip
VERBS = (
    "import_", "simulate", "analyze", "calibrate", "diagnose", "report", "learn", "record", "export", "info",
    "view", "demo",
)  # fmt: skip
"""The functions behind the commands, each in the module of its name in :mod:`fleetlog.verbs`."""

__all__ = [
    "FORMAT_VERSION", "Dataset", "FleetlogError", "Result", "Trajectory", "__version__", "analyze",
    "calibrate", "demo", "diagnose", "export", "import_", "info", "learn", "open", "read_logs", "record",
    "report", "simulate", "view",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in NAMES and name not in VERBS:
        raise AttributeError(f"module 'fleetlog' has no attribute {name!r}")
    module, _, attribute = NAMES.get(name, f"verbs.{name}:{name}").partition(":")
    globals()[name] = found = getattr(importlib.import_module(f"fleetlog.{module}"), attribute)
    return found


def __dir__() -> list[str]:
    return [*__all__]


class _Face(ModuleType):
    """The package as users see it: ``fleetlog.simulate`` stays the function when its package is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in VERBS and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face
