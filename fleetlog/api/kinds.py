"""What arguments of the functions of the library may be: names of files, objects, DataFrames.

To a type checker each is a union of types; to the commands it is a value with its name in help.
"""

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from fleetlog.core.arguments import Named

if TYPE_CHECKING:
    from pandas import DataFrame

    from fleetlog.api.answer import Answer
    from fleetlog.core.site import Site
    from fleetlog.core.truck import Truck
    from fleetlog.physics.power import Physics
    from fleetlog.store import Dataset
else:
    Answer = DataFrame = Dataset = Physics = Site = Truck = Any  # nothing heavy is imported for them

PathLike: TypeAlias = Annotated[str | os.PathLike[str], Named("PATH", path=True)]
TableLike: TypeAlias = Annotated[PathLike | DataFrame, Named("FILE", path=True)]
TruckLike: TypeAlias = Annotated[PathLike | Truck | Answer, Named("TRUCK", path=True)]
SiteLike: TypeAlias = Annotated[PathLike | Site, Named("FILE", path=True)]
PhysicsLike: TypeAlias = Annotated[PathLike | Physics | Answer, Named("PATH", path=True)]
LogsLike: TypeAlias = Annotated[TableLike | Sequence[TableLike], Named("LOG", path=True, many=True)]
DatasetLike: TypeAlias = Annotated[PathLike | Dataset | Answer | DataFrame, Named("DATASET", path=True)]
Datasets: TypeAlias = DatasetLike | Sequence[DatasetLike]
DatasetsLike: TypeAlias = Annotated[Datasets, Named("DATASET", path=True, many=True)]
MeasurementsLike: TypeAlias = Annotated[Datasets, Named("MEASUREMENTS", path=True, many=True)]
