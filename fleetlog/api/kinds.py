"""What arguments of the functions of the library may be: names of files, objects, DataFrames.

To a type checker each is a union of types; to the commands it is a value with its name in help.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from fleetlog.core.arguments import Named

if TYPE_CHECKING:
    import pandas as pd

    from fleetlog.api.answer import Answer
    from fleetlog.core.site import Site
    from fleetlog.core.truck import Truck
    from fleetlog.physics.power import Physics
    from fleetlog.store import Dataset

    PathLike: TypeAlias = "str | os.PathLike[str]"
    DatasetLike: TypeAlias = "PathLike | Dataset | Answer | pd.DataFrame"
    TableLike: TypeAlias = "PathLike | pd.DataFrame"
    TruckLike: TypeAlias = "PathLike | Truck | Answer"
    SiteLike: TypeAlias = "PathLike | Site"
    PhysicsLike: TypeAlias = "PathLike | Physics | Answer"
    LogsLike: TypeAlias = "PathLike | pd.DataFrame | Sequence[PathLike | pd.DataFrame]"
    MeasurementsLike: TypeAlias = "DatasetLike | Sequence[DatasetLike]"
    DatasetsLike: TypeAlias = "DatasetLike | Sequence[DatasetLike]"
else:
    PathLike = Annotated[Any, Named("PATH", path=True)]
    DatasetLike = Annotated[Any, Named("DATASET", path=True)]
    TableLike = Annotated[Any, Named("FILE", path=True)]
    TruckLike = Annotated[Any, Named("TRUCK", path=True)]
    SiteLike = Annotated[Any, Named("FILE", path=True)]
    PhysicsLike = Annotated[Any, Named("PATH", path=True)]
    LogsLike = Annotated[tuple[Any, ...], Named("LOG", path=True)]
    MeasurementsLike = Annotated[tuple[Any, ...], Named("MEASUREMENTS", path=True)]
    DatasetsLike = Annotated[tuple[Any, ...], Named("DATASET", path=True)]
