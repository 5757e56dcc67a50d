"""The real command, run as a person or a script would; fast because the interpreter is shared where a process is not the point."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import duckdb
import pytest

HEAD = "vehicle_id,timestamp,latitude,longitude\n"


@dataclass
class Done:
    """What a command left: status, standard output, standard error."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """The one object on standard output."""
        assert len(self.out.splitlines()) == 1, self.out
        return json.loads(self.out)


Run = Callable[..., Done]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Run]:
    """``fleetlog`` through its entry point, in an empty folder; the signals are handled as before afterwards."""
    from fleetlog import interrupt
    from fleetlog.cli.main import entry

    before = {number: signal.getsignal(number) for number in interrupt.SIGNALS}
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["fleetlog", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            entry()
        said = capsys.readouterr()
        assert "Traceback" not in said.err and "a fault in fleetlog itself" not in said.err, said.err
        return Done(int(stop.value.code or 0), said.out, said.err)

    yield call
    for number, handler in before.items():
        signal.signal(number, handler)


def process(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """``fleetlog`` as a process of its own."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options}
    return subprocess.Popen([sys.executable, "-m", "fleetlog", *map(str, arguments)], **options)


def drive(
    vehicle: str = "a",
    rows: int = 30,
    every: float = 1.0,
    start: str = "2026-03-02T05:00:00",
    east: float = 1e-5,
    longitude: float = 9.15,
) -> list[list[str]]:
    """Rows of a truck that drives east (0.717 m a row by default) along 49.97 north."""
    begin = datetime.fromisoformat(start).replace(tzinfo=UTC)
    stamps = [(begin + timedelta(seconds=i * every)).isoformat().replace("+00:00", "Z") for i in range(rows)]
    return [[vehicle, t, "49.97", f"{longitude + i * east:.9f}"] for i, t in enumerate(stamps)]


def log(path: Path, rows: Iterable[Iterable[object]], head: str = HEAD, encoding: str = "utf-8") -> Path:
    """A CSV of these rows."""
    text = head + "".join(",".join(map(str, r)) + "\n" for r in rows)
    path.write_text(text, encoding=encoding)
    return path


def ask(dataset: Path, what: str, rest: str = "") -> list[tuple[Any, ...]]:
    """``select WHAT from DATASET REST``, by DuckDB as the page tells it."""
    files = f"read_parquet('{dataset}/trajectories/**/*.parquet', hive_partitioning = true)"
    return duckdb.sql(f"select {what} from {files} {rest}").fetchall()


ROAD = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"id": "r"},
            "geometry": {"type": "LineString", "coordinates": [[9.149, 49.97], [9.152, 49.97]]},
        }
    ],
}


@pytest.fixture
def road(tmp_path: Path) -> Path:
    """A map of one road ``r`` from west to east."""
    path = tmp_path / "road.geojson"
    path.write_text(json.dumps(ROAD), encoding="utf-8")
    return path
