"""Write one page about a fleet, about two datasets side by side, or about an experiment."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

from fleetlog.api import inputs
from fleetlog.api.answer import Answer, destination
from fleetlog.api.inputs import DatasetLike, DatasetsLike, PathLike, TruckLike
from fleetlog.api.verb import verb


@verb(jobs=True)
def report(
    datasets: DatasetsLike, *, truck: TruckLike | None = None, tariff: PathLike | None = None,
    timezone: str | None = None, diagnosis: bool = True, tables: PathLike | None = None,
    output: PathLike | None = None, overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Write one page about the fleet of a dataset, about two DATASETS side by side, or about an experiment.

    The page is one file: it needs no network, and can be printed or read on a phone.  Of two datasets it
    tells how the second differs from the first, and whether that is more than chance.

    Parameters
    ----------
    datasets : one or two datasets, recorded or simulated; or the folder of an experiment.
    truck : truck file, or name of a preset: energy by cause, and what the truck model leaves out.
    tariff : prices and CO2 of energy by hour (TOML).
    timezone : time zone of the hours, as Europe/Berlin; that of the site by default.
    diagnosis : run diagnose where a truck is given.
    tables : write the tables too: a folder for Parquet files, or NAME.xlsx.
    output : HTML page to write."""
    from fleetlog.report.report import Report, held, write_tables
    from fleetlog.report.report import report as reported

    given = cast("Sequence[DatasetLike]", datasets)
    folders = [Path(d) for d in given if isinstance(d, str | Path) and len(given) == 1]
    pages = [f / "report.html" for f in folders if (f / "experiment.json").is_file()]
    opened = [] if pages else [inputs.as_dataset(d) for d in given]
    model = None if truck is None else inputs.as_truck(truck)
    prices = None if tariff is None else inputs.existing(tariff)
    read = inputs.files_of(datasets, truck, tariff)
    with (
        destination(output, "report", overwrite, read, folder=False) as keep,
        held(None if tables is None else inputs.as_path(tables), overwrite, read) as place,
    ):
        found = Report(inputs.existing(pages[0]).read_text("utf-8")) if pages else None
        found = found or reported(opened, truck=model, tariff=prices, timezone=timezone, diagnosis=diagnosis)
        if place is not None:
            write_tables(place, found.tables, found.zone)
        answer = Answer("report", found.summary, found.tables, lines=found.lines, value=found)
        answer.page = found.html
        answer.write = lambda file: file.write_text(found.html, encoding="utf-8")
        return keep(answer)
