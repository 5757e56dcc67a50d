"""Arguments of the functions of the library: unions of types to a type checker, to commands named values."""

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, cast

from fleetlog import scratch
from fleetlog.core.arguments import Named
from fleetlog.core.files import is_url, located
from fleetlog.errors import InputError
from fleetlog.listening import notice

if TYPE_CHECKING:
    from pandas import DataFrame

    from fleetlog.api.answer import Answer
    from fleetlog.core.network import Network
    from fleetlog.core.site import Site
    from fleetlog.core.truck import Truck
    from fleetlog.physics.power import Physics
    from fleetlog.store import Dataset
else:
    # Nothing heavy is imported for them.
    Answer = DataFrame = Dataset = Network = Physics = Site = Truck = Any

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


def as_dataset(value: DatasetLike) -> Dataset:
    """Open a dataset; a DataFrame is imported first, into a temporary folder."""
    from fleetlog.store import Dataset, DatasetWriter

    if isinstance(value, Dataset):
        return value
    if not _is_frame(value):
        return cast("Dataset", value.dataset) if hasattr(value, "dataset") else Dataset(as_path(value))
    from fleetlog.core.site import Site
    from fleetlog.ingest.pipeline import import_logs

    folder = scratch.folder() / "dataset"
    with DatasetWriter.create(folder, "recorded", Site()) as writer:
        import_logs([as_path(value)], None, writer)
    return Dataset(folder)


def as_truck(value: TruckLike) -> Truck:
    """Load a truck, a preset by its name, or take that of a calibration."""
    from fleetlog.core.truck import Truck, load_truck

    if isinstance(value, Truck):
        return value
    return cast("Truck", value.value.truck) if hasattr(value, "value") else load_truck(as_path(value))


def as_site(value: SiteLike) -> Site:
    """Load a site or map; what was read of the map is a notice."""
    from fleetlog.core.site import Site

    if isinstance(value, Site):
        return value
    from fleetlog.roads import load_site

    site, reports = load_site(existing(value))
    for report in reports:
        notice(report.line())
    return site


def as_physics(value: PhysicsLike, truck: Truck, network: Network | None = None) -> Physics:
    """Load a model file, or take the physics that a diagnosis found."""
    from fleetlog.physics.power import Physics

    if isinstance(value, Physics):
        return value
    if hasattr(value, "value"):
        from fleetlog.discovery.report.output import physics

        return physics(value.value)
    from fleetlog.physics.model import load_physics

    return load_physics(existing(value), truck, network)


def as_path(value: Any) -> Path:
    """Return a path; a DataFrame is written to a temporary file first, a dataset is its folder."""
    if _is_frame(value):
        return _written(value, "table.parquet")
    if hasattr(value, "dataset"):
        value = value.dataset
    path = located(value if is_url(value) else getattr(value, "path", value))
    if is_url(path):
        return path
    try:
        with suppress(OSError):
            path.stat()
    except ValueError:  # of what no file can be called
        raise InputError("is no name of a file", where=repr(str(path)), do="correct it") from None
    return path


def as_csv(value: Any) -> Path:
    """Return the path of a CSV file; a DataFrame is written to a temporary one, a dataset is its folder."""
    return _written(value, "table.csv") if _is_frame(value) else existing(value)


def existing(value: Any) -> Path:
    """Return the path of something that is there; :class:`InputError` where nothing is."""
    path = as_path(value)
    if not path.exists():
        raise InputError("does not exist", where=path, do="check the name")
    return path


def files_of(*values: Any) -> list[Path]:
    """Return the paths of this machine among arguments: what a run reads and must not write over."""
    some = [v for value in values for v in (value if isinstance(value, list | tuple) else (value,))]
    named = [v for v in some if isinstance(v, str | os.PathLike) or hasattr(v, "path")]
    return [as_path(v) for v in named if not (is_url(v) or is_url(getattr(v, "path", "")))]


def _is_frame(value: Any) -> bool:
    return hasattr(value, "to_parquet") and hasattr(value, "columns")


def _written(frame: Any, name: str) -> Path:
    """A temporary file of a table; a named index (of time, say) is a column."""
    file = scratch.folder() / name
    plain = frame.reset_index() if any(frame.index.names) else frame
    (plain.to_csv if name.endswith(".csv") else plain.to_parquet)(file, index=False)
    return file


LOADED: dict[str, tuple[str, Callable[..., Any]]] = {
    "Dataset": ("DATASET", as_dataset), "Truck": ("TRUCK", as_truck), "Site": ("FILE", as_site),
    "Physics": ("PATH", as_physics),
}  # fmt: skip
"""Types that an analysis takes: their name in help, and how one is loaded; physics for a truck and a map."""
