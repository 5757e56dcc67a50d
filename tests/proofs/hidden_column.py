"""Public logs with the column that explains them withheld, diagnosed, and judged against that column afterwards.

    python -m tests.proofs.hidden_column tripviewer|twizy|borealtc|bike|escooter[-uneven|-fifth|-half] DATA OUT

DATA is the folder of public logs (docs/proof.md says where they come from).  The altitude, or the surface, is never
written into the dataset that ``fleetlog diagnose`` reads; this script alone looks at it, at the end.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from fleetlog.core.site import Site
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.report.output import lines, write_diagnosis
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids
from tests.proofs.hidden_judges import by_altitude, by_surface, classes, profiles
from tests.proofs.public_logs import READERS, Log, poorer


def run(name: str, data: Path, out: Path) -> tuple[Diagnosis, Log]:
    """Write the dataset without the column, and diagnose it."""
    kind, _, lack = name.partition("-")
    log = READERS[kind](data)
    log = poorer(log, lack) if lack else log
    out.mkdir(parents=True, exist_ok=True)
    with DatasetWriter.create(
        out / f"{name}_data", "recorded", Site(name, log.frame), overwrite=True
    ) as writer:
        known = log.track.has("trip_id")
        writer.write(log.track if known else log.track.with_columns(trip_id=trip_ids(log.track)))
    return diagnose(Dataset(out / f"{name}_data"), log.truck, holdout=log.holdout), log


def judged(d: Diagnosis, log: Log) -> dict[str, Any]:
    """The agreement of what was found with what was withheld."""
    return by_surface(classes(d, log)) if log.labels else by_altitude(profiles(d, log))


def main(name: str, data: Path, out: Path) -> None:
    """Diagnose, judge, draw, and print all of it."""
    from tests.proofs.hidden_pictures import draw

    begin = time.process_time()
    d, log = run(name, data, out)
    seconds = time.process_time() - begin
    folder = out / f"{name}_diagnosis"
    folder.mkdir(exist_ok=True)
    write_diagnosis(d, folder)
    verdict = judged(d, log)
    draw(name.partition("-")[0], d, log, out / f"{name}.png")
    print("\n".join(lines(d)))
    print(json.dumps(verdict, indent=1))
    print(f"{seconds:.0f} CPU seconds; pictures and report in {out}")
    (out / f"{name}.json").write_text(json.dumps(verdict, indent=1))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
