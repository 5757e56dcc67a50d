"""Logs as a spreadsheet exports them in another country; the tutorial maps them with a profile.

    python sample_data/make_messy.py

``shift.csv`` has ten minutes of the sample fleet; ``week-10.csv.gz`` and ``week-11.csv.gz`` twenty minutes of four
trucks on each of ten mornings.  In the second week the trucks have softer tyres: they roll 1.4 times as hard.
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from make_plant import geographic
from recorder import record

HERE = Path(__file__).parent
HEAD = ["Datum", "Uhrzeit", "Stapler", "Breite", "Laenge", "Geschw", "Last", "Leistung", "Ladestand"]
MONDAYS = {10: datetime(2026, 3, 2, 6, tzinfo=UTC), 11: datetime(2026, 3, 9, 6, tzinfo=UTC)}
TYRES = {10: 1.0, 11: 1.4}
EVERY, PAGE = 4, 1500
"""Seconds between two rows of a truck in the weeks' logs; rows between two headers of a print-out."""


def comma(value: Any, digits: int, factor: float = 1.0) -> str:
    """A number with a decimal comma."""
    return f"{float(value) * factor:.{digits}f}".replace(".", ",")


def row(r: dict[str, Any]) -> list[str]:
    """Local time in two columns, km/h, tonnes, kW, per cent."""
    local = datetime.fromisoformat(r["timestamp"]).astimezone(ZoneInfo("Europe/Berlin"))
    return [
        local.strftime("%d.%m.%Y"), local.strftime("%H:%M:%S"), r["vehicle_id"], comma(r["latitude"], 7),
        comma(r["longitude"], 7), "-1" if r["speed"] == "" else comma(r["speed"], 1, 3.6),
        comma(r["payload"], 2, 1e-3), comma(r["battery_power"], 2, 1e-3), comma(r["soc"], 1, 100.0),
    ]  # fmt: skip


def text(rows: list[list[str]]) -> str:
    """The file, with a title line above its header."""
    out = io.StringIO(newline="")
    out.write("Fuhrpark Werk 2 - Auszug\r\n")
    csv.writer(out, delimiter=";").writerows([HEAD, *rows])
    return out.getvalue()


def shift() -> list[list[str]]:
    """Ten minutes of ``fleet.csv.gz``."""
    with gzip.open(HERE / "logs" / "fleet.csv.gz", "rt", encoding="utf-8") as stream:
        rows = [row(r) for r in csv.DictReader(stream) if r["timestamp"] < "2026-03-02T06:10:00"]
    rows[7][5], rows[20][3] = "-1", "n/v"
    return rows


def morning(start: datetime, seed: int, tyres: float) -> Iterator[list[str]]:
    """Twenty minutes of four trucks."""
    trucks = record(seed, fleet=4, duration=1200.0, tyres=tyres)
    for step in zip(*(truck.rows[::EVERY] for truck in trucks), strict=False):
        for truck, (t, x, y, speed, load, _, power, soc, *_) in zip(trucks, step, strict=True):
            longitude, latitude = geographic(x, y)
            moment = (start + timedelta(seconds=round(t))).isoformat()
            yield row({
                "vehicle_id": truck.id, "timestamp": moment, "latitude": latitude, "longitude": longitude,
                "speed": speed, "payload": load, "battery_power": power, "soc": soc,
            })  # fmt: skip


def week(number: int) -> list[list[str]]:
    """Five mornings, with what print-outs leave in a file: headers, a cut row, marks for unknown values."""
    days = [MONDAYS[number] + timedelta(days=day) for day in range(5)]
    rows = [r for day in days for r in morning(day, 100 * number + day.day, TYRES[number])]
    rows[11][5], rows[40][6], rows[300][3], rows[900][8] = "-1", "", "n/v", "n/v"
    rows[2000] = rows[2000][:5]
    for at in range(len(rows) // PAGE * PAGE, 0, -PAGE):
        rows.insert(at, HEAD)
    return rows


def main() -> None:
    """All three files."""
    folder = HERE / "messy"
    folder.mkdir(exist_ok=True)
    (folder / "shift.csv").write_bytes(text(shift()).encode("latin-1"))
    for number in MONDAYS:
        packed = gzip.compress(text(week(number)).encode("latin-1"), 9, mtime=0)
        (folder / f"week-{number}.csv.gz").write_bytes(packed)


if __name__ == "__main__":
    main()
