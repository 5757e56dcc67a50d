"""Ten minutes of the sample fleet as a spreadsheet export from another country; the tutorial maps it with a profile.

python sample_data/make_messy.py
"""

from __future__ import annotations

import csv
import gzip
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

HERE = Path(__file__).parent
HEAD = ["Datum", "Uhrzeit", "Stapler", "Breite", "Laenge", "Geschw", "Last", "Leistung", "Ladestand"]


def comma(value: str, digits: int, factor: float = 1.0) -> str:
    """A number with a decimal comma."""
    return f"{float(value) * factor:.{digits}f}".replace(".", ",")


def row(r: dict[str, str]) -> list[str]:
    """Local time in two columns, km/h, tonnes, kW, per cent."""
    local = datetime.fromisoformat(r["timestamp"]).astimezone(ZoneInfo("Europe/Berlin"))
    return [
        local.strftime("%d.%m.%Y"), local.strftime("%H:%M:%S"), r["vehicle_id"], comma(r["latitude"], 7),
        comma(r["longitude"], 7), "-1" if r["speed"] == "" else comma(r["speed"], 1, 3.6),
        comma(r["payload"], 2, 1e-3), comma(r["battery_power"], 2, 1e-3), comma(r["soc"], 1, 100.0),
    ]  # fmt: skip


with gzip.open(HERE / "logs" / "fleet.csv.gz", "rt", encoding="utf-8") as stream:
    rows = [row(r) for r in csv.DictReader(stream) if r["timestamp"] < "2026-03-02T06:10:00"]
rows[7][5], rows[20][3] = "-1", "n/v"
with (HERE / "messy" / "shift.csv").open("w", newline="", encoding="latin-1") as out:
    out.write("Fuhrpark Werk 2 - Auszug\r\n")
    writer = csv.writer(out, delimiter=";")
    writer.writerows([HEAD, *rows])
