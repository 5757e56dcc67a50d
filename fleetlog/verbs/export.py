"""Write a dataset in another format."""

from typing import Annotated

from fleetlog.api.answer import Answer
from fleetlog.api.inputs import DatasetLike, PathLike, as_dataset, as_path
from fleetlog.api.verb import verb
from fleetlog.core.arguments import PartOf


@verb()
def export(
    dataset: DatasetLike, *, to: Annotated[str, PartOf("fleetlog.exporters", "write")], output: PathLike,
    vehicle: tuple[str, ...] = (), overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Write DATASET in another format: tables, tasks, tracks, recordings, SUMO, OpenSCENARIO.

    Parameters
    ----------
    to : format of the file.
    output : file to write."""
    from fleetlog.exporters.base import export_dataset

    data, file = as_dataset(dataset), as_path(output)
    summary = export_dataset(data, to, file, vehicles=vehicle, overwrite=overwrite)
    what = "edges" if "edges" in summary else "rows"
    lines = [f"{summary['rows']:,} {what} of {data.path}, {summary['bytes']:,} bytes of {to}"]
    if left_out := summary.get("rows_without_position"):
        lines.append(f"{left_out:,} rows have no position and were left out")
    return Answer("export", summary, lines=lines, output=file, kind=f"{to} export", folder=False)
