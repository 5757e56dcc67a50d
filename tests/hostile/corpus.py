"""Some thousand broken and hostile files, each with what is to become of it.

A case says the exit status that the file deserves (0 done, 1 refused, 3 read in part), what is said (a pattern), and how many
rows are kept.  ``how`` is ``read`` for a log as its reader gives it, ``settings`` for maps and files of settings.
"""

from __future__ import annotations

import bz2
import gzip
import json
import struct
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, NamedTuple

import seeds
from seeds import ROWS, iso

from fleetlog.core.truck import SECTIONS


class Case(NamedTuple):
    """One file and its fate."""

    name: str
    file: str
    data: bytes
    status: int
    says: str = ""
    rows: int | None = None
    how: str = "read"


LONG = "9" * 400
NO_NUMBERS = [
    "abc",
    "inf",
    "-inf",
    "1e400",
    LONG,
    "0x10",
    "1_000",
    "--1",
    "1.2.3",
    "\u0663",
    "1 2",
    "true",
    "None1",
    "+",
    "e5",
]
UNKNOWN = ["", "NA", "nan", "null", "-", "N/A"]
NO_TIMES = ["yesterday", "2026-13-45T00:00:00Z", "99999-01-01T00:00:00Z", "12:30:00", "1e99", "1600-01-01T00:00:00Z",
            "3000-01-01T00:00:00Z", "2026-02-30", LONG, "0000-00-00", "\u0662\u0660\u0662\u0666"]  # fmt: skip
NAMES = [
    "../../x",
    "a/b",
    "a\\b",
    "\u202etxt",
    "=1+1",
    "@x",
    "T" * 300,
    "date=1",
    "\U0001f69c",
    "T\x1b[31m",
    "__HIVE_DEFAULT_PARTITION__",
]


def cases() -> Iterator[Case]:
    """All of them."""
    for part in (_csv_cells, _csv_shape, _cut_texts, _bad_records, _vda, _geojson, _xml, _parquet, _mcap, _bags, _packed, _truck, _site,
                 _profile, _model, _maps):  # fmt: skip
        yield from part()


def _cell(line: int, column: int, value: str) -> bytes:
    lines = seeds.csv().decode().split("\n")
    cells = lines[line].split(",")
    cells[column] = value
    lines[line] = ",".join(cells)
    return "\n".join(lines).encode()


def _csv_cells() -> Iterator[Case]:
    for column, name in enumerate(seeds.csv().decode().split("\n")[0].split(",")):
        place = name in ("x", "y")
        for k, value in enumerate(NO_NUMBERS):
            if place or name in ("speed", "soc"):
                kept = ROWS - place
                yield Case(
                    f"csv {name} {k}", "a.csv", _cell(8, column, value), 3, f"{name} is not a number", kept
                )
        for k, value in enumerate(UNKNOWN):
            refused = name in ("vehicle_id", "timestamp")
            yield Case(
                f"csv {name} unknown {k}",
                "a.csv",
                _cell(8, column, value),
                3 * refused,
                "missing" * refused,
                ROWS - refused,
            )
    for k, value in enumerate(NO_TIMES):
        yield Case(f"csv time {k}", "a.csv", _cell(8, 1, value), 3, "the time", ROWS - 1)
    for k, value in enumerate(NAMES):
        for column in (0, 6):
            long = not column and (len(value) > 200 or value.startswith("__HIVE"))
            yield Case(
                f"csv name {k} in {column}",
                "a.csv",
                _cell(8, column, value),
                3 * long,
                "longer than" * long,
                ROWS - long,
            )


def _csv_shape() -> Iterator[Case]:
    whole = seeds.csv()
    lines = whole.split(b"\n")
    for k in range(2, ROWS, 4):
        mixed = b"\r".join(lines[:k]) + b"\r" + b"\n".join(lines[k:])
        yield Case(f"csv CR before line {k}, LF after", "a.csv", mixed, 0, "", ROWS)
        mixed = b"\n".join(lines[:k]) + b"\n" + b"\r".join(lines[k:])
        yield Case(f"csv LF before line {k}, CR after", "a.csv", mixed, 0, "", ROWS)
        for cell in (2, 3, 6):
            yield Case(
                f"csv stray CR in {k}, {cell}",
                "a.csv",
                _cell(k, cell, "\r" + lines[k].decode().split(",")[cell]),
                0,
                "carriage",
                ROWS,
            )
        yield Case(f"csv quote opened in {k}", "a.csv", _cell(k, 6, '"n'), 3, "quotation|cut off", None)
        yield Case(f"csv quote over rows {k}", "a.csv", whole.replace(b"n%d\n" % (k - 1), b'"n\n').replace(b"n%d\n" % (k + 1), b'n"\n'),
                   3, "quotation", ROWS)  # fmt: skip
        for bad in (b"\xff", b"\xe4", b"\xed\xa0\x80", b"\xc3"):
            data = whole.replace(b"n%d\n" % k, b"n" + bad + b"\n")
            yield Case(f"csv bad UTF-8 {bad!r} in {k}", "a.csv", data, 0, "UTF-8", ROWS)
    for size in (131_072, 131_073, 1_000_000):
        yield Case(f"csv cell of {size}", "a.csv", _cell(8, 6, "x" * size), 0, "", ROWS)
        yield Case(f"csv quoted cell of {size}", "a.csv", _cell(1, 6, '"' + "x" * size + '"'), 0, "", ROWS)
    yield Case(
        "csv line of 17 MB",
        "a.csv",
        _cell(8, 6, "x" * (17 << 20)),
        3,
        "after record 8: the line is longer than 8 MB",
    )
    head, rest = whole.split(b"\n", 1)
    yield Case("csv unnamed field", "a.csv", head + b"\n" + rest.replace(b"\n", b",7\n"), 0, "column_8", ROWS)
    yield Case(
        "csv separator behind rows", "a.csv", head + b"\n" + rest.replace(b"\n", b",\n"), 0, "column_8", ROWS
    )
    yield Case(
        "csv separator behind some rows", "a.csv", whole.replace(b"n7\n", b"n7,\n"), 0, "empty field", ROWS
    )
    yield Case(
        "csv separator behind the header", "a.csv", head + b",\n" + rest, 0, "ends with a separator", ROWS
    )
    yield Case("csv one field more", "a.csv", whole.replace(b"n7\n", b"n7,8\n"), 3, "more fields", ROWS - 1)
    yield Case("csv one field less", "a.csv", whole.replace(b",n7\n", b"\n"), 3, "fewer fields", ROWS - 1)
    for name in (b"x", b"note", b"column_2", b"timestamp", b"a_b"):
        double = head + b"," + b",".join([name] * 3) + b"\n" + rest.replace(b"\n", b",1,2,3\n")
        yield Case(f"csv {name.decode()} thrice", "a.csv", double, 0, "more than once", ROWS)
    for encoding in ("utf-16", "utf-8-sig", "utf-16-le", "cp1252"):
        yield Case(
            f"csv {encoding}", "a.csv", whole.decode().replace("n7", "ü7").encode(encoding), 0, "", ROWS
        )
    for k, data in enumerate(
        (
            b"",
            b"\n\n",
            b"\xef\xbb\xbf",
            head,
            head + b"\n",
            b"\x00" * 100,
            b"a,b\n1,2\n",
            b"#" * 1000,
            bytes(range(256)) * 9,
        )
    ):
        yield Case(f"csv nothing {k}", "a.csv", data, 1, "empty|no rows|no log format|no time|no usable|nothing") if k not in (3, 4) else Case(
            f"csv header only {k}", "a.csv", data, 0, "", 0)  # fmt: skip
    for k in range(0, ROWS, 5):
        yield Case(
            f"csv header again {k}",
            "a.csv",
            b"\n".join([*lines[: k + 1], head, *lines[k + 1 :]]),
            3,
            "header line again",
            ROWS,
        )


def _cut_texts() -> Iterator[Case]:
    """Cut off in the middle of record k: those before it are whole."""
    marks = {"csv": b"\nT", "gpx": b"<trkpt", "sumo-fcd": b"<vehicle", "vda5050": b'{"headerId', "geojson": b'{"type": "Feature", ',
             "tum": b"\n1", "nmea": b"$GPRMC"}  # fmt: skip
    for name, mark in marks.items():
        suffix, make = seeds.LOGS[name]
        data = b"\n" * (name == "tum") + make()
        at = -1
        for k in range(ROWS):
            at = data.find(mark, at + 1)
            if k % 2 and k > 2:
                yield Case(
                    f"{name} cut in record {k}",
                    f"a.{suffix}",
                    data[: at + 8],
                    3,
                    "cut off|breaks off|not eight|wrong|broken",
                    k,
                )


def _bad_records() -> Iterator[Case]:
    """Record k made unreadable: the others stay."""
    wrong = {
        "csv": lambda i: (f"T{i % 2},{iso(i)},{0.5 * i:.2f}", f"T{i % 2},{iso(i)},east"),
        "gpx": lambda i: (f'lat="{49.97 + i * 1e-5:.6f}"', 'lat="north"'),
        "sumo-fcd": lambda i: (f'id="v" x="{0.5 * i:.2f}" y', 'id="v" x="" y'),
        "vda5050": lambda i: (f'"x": {0.5 * i}, "y"', '"x": null, "y"'),
        "geojson": lambda i: (f"[9.151, {49.97 + i * 1e-5}, 100.0]", "[9.151]"),
        "tum": lambda i: (f"{seeds.START + i}.5 ", "soon "),
    }
    for name, change in wrong.items():
        suffix, make = seeds.LOGS[name]
        for i in range(1, ROWS, 2):
            old, new = change(i)
            data = make().decode()
            assert old in data, (name, old)
            yield Case(
                f"{name} bad record {i}", f"a.{suffix}", data.replace(old, new, 1).encode(), 3, "", ROWS - 1
            )
    for i in range(1, ROWS, 4):
        old = f"GPRMC,0500{i:02d}.00,A".encode()
        data = seeds.nmea().replace(old, old[:-1] + b"B")
        yield Case(f"nmea checksum {i}", "a.nmea", data, 3, "checksum", ROWS)


JSON_BAD: list[Any] = [
    "text",
    None,
    True,
    [],
    {},
    [1],
    {"a": 1},
    float("nan"),
    float("inf"),
    10**400,
    "\ud800",
    "NaN",
]


def _changed(message: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    message = json.loads(json.dumps(message))
    *outer, last = path.split(".")
    inner: Any = message
    for key in outer:
        inner = inner[int(key) if key.isdigit() else key]
    inner[int(last) if last.isdigit() else last] = value
    return message


def _vda() -> Iterator[Case]:
    lines = seeds.vda().splitlines()
    for path in ("agvPosition.x", "agvPosition.y", "timestamp", "agvPosition.theta", "batteryState.batteryCharge", "loads.0.weight", "loads",
                 "agvPosition.mapId", "batteryState.charging", "version", "serialNumber", "headerId"):  # fmt: skip
        needed = path in ("agvPosition.x", "agvPosition.y", "timestamp")
        for k, value in enumerate(JSON_BAD):
            changed = json.dumps(_changed(json.loads(lines[5]), path, value)).encode()
            data = b"\n".join([*lines[:5], changed, *lines[6:], b""])
            refused = needed or (path == "serialNumber" and value == 10**400)  # an id of 400 characters
            yield Case(f"vda {path} {k}", "a.jsonl", data, 3 * refused, "", ROWS - refused)
    heavy = json.dumps(_changed(json.loads(lines[5]), "loads", [{"weight": 1e308}] * 3)).encode()
    yield Case(
        "vda weights of 1e308", "a.jsonl", b"\n".join([*lines[:5], heavy, *lines[6:], b""]), 0, "", ROWS
    )
    yield Case(
        "vda nested", "a.jsonl", b"\n".join([*lines, b'{"a":' * 100_000, b""]), 3, "no JSON object", ROWS
    )
    yield Case(
        "vda long integer",
        "a.jsonl",
        b"\n".join([*lines, b'{"a": ' + b"9" * 5000 + b"}", b""]),
        3,
        "no JSON object",
        ROWS,
    )


def _geojson() -> Iterator[Case]:
    for path in ("geometry.coordinates.0", "geometry.coordinates.1", "geometry.coordinates", "properties.timestamp", "properties.speed",
                 "properties.note", "geometry.coordinates.2"):  # fmt: skip
        needed = path not in ("properties.speed", "properties.note", "geometry.coordinates.2")
        for k, value in enumerate(JSON_BAD):
            if path.endswith(("0", "1")) and value == "NaN":
                value = "east"
            changed = [seeds.feature(i) for i in range(ROWS)]
            changed[5] = _changed(changed[5], path, value)
            said = needed or (path.endswith("speed") and isinstance(value, str) and value != "NaN")
            yield Case(
                f"geojson {path} {k}", "a.geojson", seeds.collection(changed), 3 * said, "", ROWS - needed
            )
    # Their size says ns for the first three: the last moment before 2262, the first after it.
    for k, stamp in enumerate((9.3e18, -9.3e18, 9.9e16, 1e300, 10**400, 10**30)):
        changed = [seeds.feature(i) for i in range(ROWS)]
        changed[5]["properties"]["timestamp"] = stamp
        yield Case(f"geojson stamp {k}", "a.geojson", seeds.collection(changed), 3, "", ROWS - 1)
    for lists in range(1, 4):
        data = seeds.lines(4, lists)
        yield Case(
            f"geojson times of {lists} of 4 lines", "a.geojson", data, 3, "line without a time", 10 * lists
        )
    yield Case(
        "geojson surrogate in a name",
        "a.geojson",
        seeds.collection([seeds.feature(i, **{"\ud800": 1}) for i in range(ROWS)]),
        0,
        "",
        ROWS,
    )
    yield Case(
        "geojson surrogate as vehicle",
        "a.geojson",
        seeds.collection([seeds.feature(i, vehicle_id="\udfff") for i in range(ROWS)]),
        0,
        "",
        ROWS,
    )


def _xml() -> Iterator[Case]:
    bad = ["north", "", "nan", "inf", "1e400", LONG]
    gpx, fcd = seeds.gpx().decode(), seeds.fcd().decode()
    for k, value in enumerate(bad):
        for name, old, needed in (("lat", 'lat="49.970050"', True), ("lon", 'lat="49.970050" lon="9.151000"', True), ("ele", "<ele>105</ele>", False),
                                  ("time", iso(5), True)):  # fmt: skip
            new = {
                "lat": f'lat="{value}"',
                "lon": f'lat="49.97" lon="{value}"',
                "ele": f"<ele>{value}</ele>",
                "time": value,
            }[name]
            yield Case(
                f"gpx {name} {k}", "a.gpx", gpx.replace(old, new, 1).encode(), 3 * needed, "", ROWS - needed
            )
        for name, old, needed in (
            ("x", 'x="2.50"', True),
            ("time", 'time="5.00"', True),
            ("y", 'x="2.50" y="2.00"', True),
        ):
            new = {"x": f'x="{value}"', "time": f'time="{value}"', "y": f'x="2.50" y="{value}"'}[name]
            yield Case(
                f"fcd {name} {k}", "a.xml", fcd.replace(old, new, 1).encode(), 3 * needed, "", ROWS - needed
            )
        for name in ("speed", "angle", "slope", "trip_id", "edge_id", "payload", "soc"):
            data = (
                fcd.replace(f'{name}="', f'{name}="{value}" was="', 1)
                if f'{name}="' in fcd
                else fcd.replace('id="v"', f'id="v" {name}="{value}"', 1)
            )
            wrong = name in ("payload", "soc") and value not in ("", "nan")
            yield Case(f"fcd {name} {k}", "a.xml", data.encode(), 3 * wrong, "", ROWS)
    yield Case("fcd text ids", "a.xml", fcd.replace('id="v"', 'id="Lkw &#228; 7/8"').encode(), 0, "", ROWS)
    yield Case(
        "fcd text trips",
        "a.xml",
        fcd.replace('id="v"', 'id="v" trip_id="first"').encode(),
        0,
        "trip_id_log",
        ROWS,
    )
    for stamp in ("1e11", "-1e13", "9e15"):
        yield Case(
            f"fcd time {stamp}",
            "a.xml",
            fcd.replace('time="5.00"', f'time="{stamp}"').encode(),
            3,
            "",
            ROWS - 1,
        )
    laughs = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 20 if i else "ha"}">' for i in range(12))
    yield Case(
        "gpx entities",
        "a.gpx",
        gpx.replace("<gpx", f"<!DOCTYPE gpx [{laughs}]><gpx", 1).replace(iso(5), "&a11;").encode(),
        3,
        "",
        None,
    )


def _parquet() -> Iterator[Case]:
    import numpy as np
    import pyarrow as pa

    n = range(ROWS)
    texts = [f"{0.5 * i}" for i in n]
    micro = [(seeds.START + i) * 1_000_000 for i in n]

    def case(name: str, status: int, says: str, rows: int, **columns: Any) -> Case:
        return Case(f"parquet {name}", "a.parquet", seeds.parquet(**columns), status, says, rows)

    yield case("x as text", 0, "", ROWS, x=texts)
    yield case("x and y as text", 0, "", ROWS, x=texts, y=texts)
    yield case("speed as text", 0, "", ROWS, speed=texts)
    for k, value in enumerate(NO_NUMBERS):
        yield case(f"bad x {k}", 3, "not a number", ROWS - 1, x=[*texts[:5], value, *texts[6:]])
        yield case(f"bad speed {k}", 3, "speed is not a number", ROWS, speed=[*texts[:5], value, *texts[6:]])
    for kind in (
        pa.float32(),
        pa.int8(),
        pa.int64(),
        pa.uint16(),
        pa.decimal128(10, 2),
        pa.dictionary(pa.int8(), pa.float64()),
    ):
        values = pa.array([float(i % 100) for i in n], pa.float64())
        yield case(
            f"y as {kind}",
            0,
            "",
            ROWS,
            y=values.dictionary_encode() if pa.types.is_dictionary(kind) else values.cast(kind),
        )
    for k, kind in enumerate(
        (
            pa.list_(pa.int8()),
            pa.binary(),
            pa.struct([("a", pa.int8())]),
            pa.bool_(),
            pa.null(),
            pa.time32("s"),
        )
    ):
        yield case(f"own {k}", 0, "", ROWS, own=pa.nulls(ROWS, kind))
    for kind in (
        pa.timestamp("s"),
        pa.timestamp("ms", "Europe/Berlin"),
        pa.timestamp("ns"),
        pa.timestamp("us"),
    ):
        yield case(f"time {kind}", 0, "", ROWS, timestamp=pa.array(micro, pa.timestamp("us")).cast(kind))
    yield case("time as text", 0, "", ROWS, timestamp=[iso(i) for i in n])
    yield case("time as int", 0, "counted in us", ROWS, timestamp=micro)
    yield case("time as float", 0, "counted in s", ROWS, timestamp=[m / 1e6 for m in micro])
    yield case(
        "time as unsigned",
        0,
        "counted in ms",
        ROWS,
        timestamp=pa.array([m // 1000 for m in micro], pa.uint64()),
    )
    for k, value in enumerate(NO_TIMES):
        yield case(f"bad time {k}", 3, "time", ROWS - 1, timestamp=[*[iso(i) for i in n][:-1], value])
    for stamp in (10**16, 2**62, -(2**62), 2**63 - 1):
        beyond = pa.array([*micro[:-1], stamp], pa.int64()).view(pa.timestamp("us", "UTC"))
        yield case(f"stamp {stamp}", 3, "time", ROWS - 1, timestamp=beyond)
    yield case(
        "time null",
        3,
        "the time is missing",
        ROWS - 1,
        timestamp=pa.array([*micro[:-1], None], pa.timestamp("us")),
    )
    yield case("time of day", 1, "", 0, timestamp=pa.array(list(n), pa.time32("s")))
    yield case("no time", 1, "a time", 0, timestamp=None)
    yield case("no position", 1, "a position", 0, x=None)
    yield case(
        "x of infinity", 3, "x is not a number", ROWS - 1, x=np.where(np.arange(ROWS) == 5, np.inf, 1.0)
    )
    yield case("vehicle null", 0, "", ROWS, vehicle_id=[None, *["T"] * (ROWS - 1)])
    yield case("vehicle as int", 0, "", ROWS, vehicle_id=[7] * ROWS)
    wrong = pa.array([b"n\xff"] * ROWS, pa.binary()).view(pa.string())
    for name in ("note", "vehicle_id", "x", "timestamp"):
        status = {"x": 3, "timestamp": 1}.get(name, 0)
        yield case(f"bad UTF-8 in {name}", status, "", ROWS * (status == 0), **{name: wrong})
    for k in range(1, 12):
        yield Case(
            f"parquet cut {k}",
            "a.parquet",
            seeds.parquet()[: len(seeds.parquet()) * k // 12],
            1,
            "cut off or damaged|no log format",
        )
    yield Case("parquet twice the same name", "a.parquet", _twice(), 0, "more than once", ROWS)


def _twice() -> bytes:
    import io

    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(seeds.parquet()))
    out = io.BytesIO()
    pq.write_table(
        pa.Table.from_arrays(
            [*table.columns, table.column("x"), table.column("x")], [*table.column_names, "x", "note"]
        ),
        out,
    )
    return out.getvalue()


def _mcap() -> Iterator[Case]:
    for packing in ("NONE", "ZSTD", "LZ4"):
        whole = seeds.mcap(packing)
        places = seeds.chunks(whole)
        for at in (places[0], places[len(places) // 2], places[-1]):
            for kind in (0, 1, 2, 5, 7, 9, 12, 15, 16, 100, 127, 128, 255):
                data = whole[:at] + bytes([kind]) + whole[at + 1 :]
                yield Case(
                    f"mcap {packing} chunk at {at} as {kind}",
                    "a.mcap",
                    data,
                    3,
                    "kind of the chunk|no record",
                    None if not kind else ROWS,
                )
            for bit in range(0, 64, 9):
                data = bytearray(whole)
                data[at + 1 + bit // 8] ^= 1 << bit % 8
                yield Case(
                    f"mcap {packing} length of chunk {at}, bit {bit}", "a.mcap", bytes(data), 3, "whole", None
                )
        for k in range(2, 12):
            yield Case(
                f"mcap {packing} cut {k}",
                "a.mcap",
                whole[: len(whole) * k // 12],
                3,
                "breaks off|cut off",
                None,
            )
    bare = seeds.mcap("NONE", statistics=False)
    yield Case("mcap without index", "a.mcap", bare, 0, "", ROWS)
    at = seeds.chunks(bare)[1]
    yield Case(
        "mcap without index, a kind of the future",
        "a.mcap",
        bare[:at] + b"\x20" + bare[at + 1 :],
        3,
        "unknown kind 32",
        None,
    )
    for k in range(5):
        short = struct.pack("<BQ", (5, 4, 3, 6, 7)[k], 3) + b"abc"
        yield Case(
            f"mcap short record {k}",
            "a.mcap",
            bare[:at] + short + bare[at:],
            3 if k < 4 else 0,
            "damaged" if k < 4 else "",
            ROWS,
        )


def _bags() -> Iterator[Case]:
    whole = seeds.bag()
    at = whole.find(b"op=\x05") + 3
    for kind in (0, 1, 2, 3, 4, 6, 7, 8, 50, 255):
        yield Case(
            f"bag chunk as {kind}",
            "a.bag",
            whole[:at] + bytes([kind]) + whole[at + 1 :],
            3,
            "kind of the chunk",
            ROWS,
        )
    inner = whole.find(b"op=\x02") + 3
    for kind in (0, 4, 6, 9, 200):
        yield Case(
            f"bag message as {kind}",
            "a.bag",
            whole[:inner] + bytes([kind]) + whole[inner + 1 :],
            3,
            "not in it",
            ROWS - 1,
        )
    # The index at the end takes half of so small a bag.
    for k in range(4, 12):
        yield Case(
            f"bag cut {k}",
            "a.bag",
            whole[: len(whole) * k // 12],
            3 if k > 10 else 1,
            "breaks off|cut off",
            None,
        )


def _packed() -> Iterator[Case]:
    import zstandard

    packers = {"gz": gzip.compress, "zst": zstandard.ZstdCompressor().compress, "bz2": bz2.compress}
    least = {"gz": 0, "zst": 6, "bz2": 99}  # twelfths that hold no whole block
    plain = seeds.csv(4000)
    row = b"T1,2026-03-02T05:00:00Z,1,2,0.5,0.5,n\n" * 27_594
    for suffix, pack in packers.items():
        packed = pack(plain)
        yield Case(f"csv.{suffix}", f"a.csv.{suffix}", packed, 0, "", 4000)
        yield Case(
            f"csv.{suffix} twice",
            f"a.csv.{suffix}",
            packed + pack(b"\n".join(plain.split(b"\n")[1:])),
            0,
            "",
            8000,
        )
        for k in (6, 9, 11):
            yield Case(
                f"csv.{suffix} cut {k}",
                f"a.csv.{suffix}",
                packed[: len(packed) * k // 12],
                3 if k > least[suffix] else 1,
                "packing|unpacked",
                None,
            )
        yield Case(f"csv.{suffix} with a tail", f"a.csv.{suffix}", packed + b"tail", 3, "packing", 4000)
        head = plain.split(b"\n")[0] + b"\n"
        bomb = pack(head) + pack(row) * 80
        yield Case(f"bomb.{suffix}", f"bomb.csv.{suffix}", bomb, 3, "unpacks to more than", None)
        for other in ("gpx", "nmea", "jsonl", "geojson", "xml", "tum"):
            name = {"jsonl": "vda5050", "xml": "sumo-fcd"}.get(other, other)
            data = seeds.LOGS[name][1]()
            yield Case(f"{other}.{suffix}", f"a.{other}.{suffix}", pack(data), 0, "", ROWS)
        for name in ("mcap", "rosbag", "parquet", "rosbag ros2"):
            suffix_of, make = seeds.LOGS[name]
            yield Case(
                f"{name} packed as {suffix}", f"a.{suffix_of}.{suffix}", pack(make()), 1, "unpack it first"
            )


BAD_NUMBERS = [
    '"x"',
    "true",
    "nan",
    "inf",
    "-inf",
    "1e400",
    LONG,
    "9" * 5000,
    "0x" + "f" * 5000,
    "[]",
    "{}",
    "2026-01-01",
    "-1e12",
    "1e12",
    "[1, 2]",
]
BAD_TEXTS = ["1", "true", "nan", "[]", "{}", '""', "2026-01-01", "[1]", "1.5"]


def _settings(file: str, name: str, text: str, says: str) -> Case:
    return Case(f"{file} {name}", file, text.encode(), 1, says, None, "settings")


def _truck() -> Iterator[Case]:
    for section, kind in SECTIONS.items():
        for f in fields(kind):
            mass = "" if f.name == "mass" else "[chassis]\nmass = 1000.0\n" if section != "chassis" else ""
            more = "mass = 1000.0\n" if section == "chassis" and f.name != "mass" else ""
            for k, value in enumerate(BAD_NUMBERS):
                yield _settings(
                    "truck.toml",
                    f"{section}.{f.name} {k}",
                    f"{mass}[{section}]\n{more}{f.name} = {value}\n",
                    f"{section}.{f.name}|TOML",
                )
            misspelt = f.name[:-2] + f.name[-1] + f.name[-2] if len(f.name) > 3 else f.name + "e"
            if misspelt != f.name:
                yield _settings(
                    "truck.toml",
                    f"{section}.{misspelt}",
                    f"{mass}[{section}]\n{more}{misspelt} = 1.0\n",
                    "unknown key",
                )
        for k, value in enumerate(("1", '"x"', "[]", "true", "[[1]]")):
            more = "[chassis]\nmass = 1e3\n" * (section != "chassis")
            yield _settings(
                "truck.toml", f"{section} {k}", f"{section} = {value}\n{more}", f"{section}: is not a table"
            )
    for k, text in enumerate(
        (
            "",
            "[chassis]",
            "name = 5\n[chassis]\nmass = 1e3",
            "a = " + "[" * 50_000,
            "\x00",
            "[chassis",
            "a = 1\na = 2",
        )
    ):
        yield _settings("truck.toml", f"whole {k}", text, "mass is missing|TOML|is not a text")


def _replaced(text: bytes, key: str, value: str) -> str:
    lines = text.decode().split("\n")
    return "\n".join(f"{key} = {value}" if line.startswith(f"{key} = ") else line for line in lines)


def _site() -> Iterator[Case]:
    for key in (
        "latitude",
        "longitude",
        "rotation",
        "x",
        "y",
        "plugs",
        "power",
        "speed_limit",
        "height",
        "polygon",
    ):
        for k, value in enumerate(BAD_NUMBERS):
            if (key, value) != ("polygon", "x"):
                yield _settings("site.toml", f"{key} {k}", _replaced(seeds.SITE, key, value), f"{key}|TOML")
    for key in ("name", "file", "traffic", "kind", "id"):
        for k, value in enumerate(BAD_TEXTS):
            yield _settings("site.toml", f"{key} {k}", _replaced(seeds.SITE, key, value), f"{key}|TOML|name")


def _profile() -> Iterator[Case]:
    for key in ("delimiter", "decimal", "encoding", "comment", "vehicle", "column", "format", "zone"):
        for k, value in enumerate(BAD_TEXTS):
            if (key, value) != ("column", "[]"):
                yield _settings(
                    "profile.toml", f"{key} {k}", _replaced(seeds.PROFILE, key, value), f"{key}|TOML"
                )
    for key, values in {
        "skip_lines": ['"x"', "-1", "nan", "1.5", LONG, "9" * 5000, "true"], "keep": ["1", '"yes"', "nan", "[]"],
        "sentinels": ["1", "[nan]", "[inf]", "[[1]]", "[{}]", f"[{LONG}]", '"x"'], "encoding": ['"utf-99"', '"rot13"', '"hex"', '"base64"', '"zip"'],
        "zone": ['"Mars/Base"', '"../../etc/passwd"', '"/etc/localtime"', '"Europe"'], "delimiter": ['",,"', '"\\n"', '"\\""', '"é"'],
        "format": ['"%Q"', '"%"', '"%Y %Y"', '"%d.%m. %H:%M"', '"%Y-%m"', '"soon"', '"%H:%M %d"'], "vehicle": ['"{stem.__class__}"', '"{x}"', '"{"'],
        "speed": ["1", "[]", "{ unit = 5 }", '{ unit = "kg" }', "{ scale = nan }", "{ scale = 1e99 }", '{ colum = "x" }', "{ sentinels = [nan] }"],
        "payload": ["1", "nan", "{ column = 1 }", '{ unit = "m" }'],
    }.items():  # fmt: skip
        for k, value in enumerate(values):
            yield _settings(
                "profile.toml", f"{key} bad {k}", _replaced(seeds.PROFILE, key, value), f"{key}|TOML"
            )
    for k, value in enumerate(
        ('"soon"', "5", '"2026-13-01"', '"12:00"', "12:00:00", "[]", '"2026-03-02T05:00:00"')
    ):
        yield _settings("profile.toml", f"origin {k}", f"[time]\norigin = {value}\n", "time.origin")
    for key in ("delimeter", "times", "colums", "sentinel", "skip_line"):
        yield _settings("profile.toml", key, f"{key} = 1\n", "unknown key; did you mean")


def _model() -> Iterator[Case]:
    for k, value in enumerate(BAD_NUMBERS[:12]):
        yield _settings("model.toml", f"power {k}", f"[term.auxiliary_load]\npower = {value}\n", "power|TOML")
        yield _settings(
            "model.toml",
            f"interval {k}",
            f"[interval.auxiliary_load]\npower = [{value}, 1.0]\n",
            "power|TOML",
        )
        yield _settings("model.toml", f"version {k}", f"format_version = {value}\n", "version|TOML")
        yield (
            _settings("model.toml", f"terms {k}", f"term = {value}\n", "term|TOML")
            if value != "{}"
            else _settings("model.toml", "x", "y = 1", "unknown key")
        )
    for k, text in enumerate(('off = ["nothing"]', "off = 5", "off = [5]", "[term.nothing]\na = 1", "[term.wind]\nnothing = 1", "[term]\nwind = 5",
                              "[interval.wind]\nwind_east = 5", "[interval.wind]\nwind_east = [1]", "[interval]\nwind = 5", "truck = 5")):  # fmt: skip
        yield _settings("model.toml", f"text {k}", text, "")


def _maps() -> Iterator[Case]:
    bad = ["x", "nan", "inf", "1e308", LONG, "9" * 5000, ""]
    xodr = seeds.OPENDRIVE
    for old in ('length="40"', 'x="10"', 'y="2.4"', 'hdg="0.5"', 'length="10"', 'curvature="0.05"', 'curvStart="0.05"', 'bU="10"', 'a="3"', 'b="0.01"',
                'sOffset="0" a', 's="30"', 'lane id="-1"'):  # fmt: skip
        name = old.split('"')[0]
        for k, value in enumerate(bad):
            new = old.replace(old.split('"')[1], value, 1) if old.split('"')[1] else old
            yield Case(
                f"xodr {old} {k}",
                "map.xodr",
                xodr.replace(old, new, 1).encode(),
                1,
                "map.xodr",
                None,
                "settings",
            )
        assert name
    for old, text, file in (('lat="49.971"', seeds.OSM, "map.osm"), ('lon="9.151"', seeds.OSM, "map.osm"), ('"x">9.151<', seeds.GRAPHML, "map.graphml"),
                            ("(9.15 ", seeds.GRAPHML, "map.graphml")):  # fmt: skip
        figure = next(p for p in ("49.971", "9.151", "9.15") if p in old)
        for k, value in enumerate(bad):
            yield Case(
                f"{file} {old} {k}",
                file,
                text.replace(old, old.replace(figure, value), 1).encode(),
                1,
                file,
                None,
                "settings",
            )
    for path, where in (("geometry.coordinates.0.0", "feature"), ("geometry.coordinates.1.1", "feature"), ("geometry.coordinates", "feature"),
                        ("properties.speed_limit", "feature"), ("properties", "feature")):  # fmt: skip
        for k, value in enumerate(("x", float("nan"), float("inf"), 10**400, [1], 1e308)):
            data = seeds.collection([_changed(seeds.ROAD, path, value)])
            yield Case(
                f"geojson map {path} {k}", "map.geojson", data, 1, f"map.geojson.*{where}", None, "settings"
            )
    for path in ("nodes.0.nodePosition.x", "nodes.1.nodePosition", "edges.0.startNodeId", "edges.0.mobileRobotTypeEdgeProperties.0.maximumSpeed",
                 "edges.1.vehicleTypeEdgeProperties.0.trajectory.knotVector", "nodes", "edges"):  # fmt: skip
        for k, value in enumerate(("x", float("nan"), float("inf"), 10**400, [1], 1e308)):
            data = json.dumps(_changed(seeds.LIF, f"layouts.0.{path}", value)).encode()
            yield Case(f"lif {path} {k}", "map.json", data, 1, "map.json", None, "settings")
    knots = _changed(
        seeds.LIF,
        "layouts.0.edges.1.vehicleTypeEdgeProperties.0.trajectory.knotVector",
        [0, 0, 0, 1e-320, 1, 1],
    )
    yield Case("lif knots that nearly coincide", "map.json", json.dumps(knots).encode(), 1, "nearly coincide", None, "settings")  # fmt: skip
    for name, data in seeds.MAPS.items():
        for k in range(1, 10):
            yield Case(f"{name} cut {k}", name, data[: len(data) * k // 10], 1, name, None, "settings")
        yield Case(f"{name} empty", name, b"", 1, "the file is empty", None, "settings")
        yield Case(f"{name} of NUL", name, bytes(1000), 1, name, None, "settings")
        yield Case(f"{name} nested", name, b'{"Feature": ' + b"[" * 100_000, 1, name, None, "settings")
    for count in (30, 100_000):
        data = b"<!-- a -->\n" * count
        yield Case(f"{count} comments", "map.osm", data + b"<!--", 1, "map.osm", None, "settings")
        yield Case(
            f"{count} comments, then a map", "map.osm", data + seeds.OSM.encode(), 0, "", 2, "settings"
        )
    for doctype in (
        '<!DOCTYPE osm [<!ENTITY a "b">]>',
        '<!DOCTYPE osm SYSTEM "file:///etc/passwd">',
        "<!DOCTYPE osm [<!ELEMENT osm ANY>]>",
    ):
        yield Case(
            f"map {doctype}",
            "map.osm",
            seeds.OSM.replace("<osm", doctype + "<osm", 1).encode(),
            1,
            "DOCTYPE|entities",
            None,
            "settings",
        )
    yield Case("a spiral of 1,600 turns", "map.xodr", seeds.OPENDRIVE.replace('curvStart="0.05"', 'curvStart="1000"').encode(), 1,
               "curvature", None, "settings")  # fmt: skip
    far = [[-170.0, 10.0], [-20.0, 10.0]]
    yield Case(
        "a road of 15,000 km",
        "map.geojson",
        seeds.collection([_changed(seeds.ROAD, "geometry.coordinates", far)]),
        1,
        "region|km",
        None,
        "settings",
    )
