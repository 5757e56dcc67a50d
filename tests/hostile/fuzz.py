"""Mutants of a whole file for every reader: rows, or one clear line, soon; never a fault of the reader.

    python tests/hostile/fuzz.py [--mutants 100000] [--seed 1] [--only NAME]

A finding is an exception that is no error of fleetlog's, a line that speaks of a fault in the reader, a warning of
Python, or more than ``SECONDS`` of processor time.  Each is kept in ``findings/`` in the folder it is run from.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import judge
import seeds

from fleetlog.errors import FleetlogError
from fleetlog.importers.base import by_name
from fleetlog.roads.load import read_map

SECONDS = 5.0
NUMBERS = [b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e400", b"1e17", b"-1", b"0", b"-0.0", b"9" * 19, b"9" * 400,
           b"9" * 5000, b"1e-320", b"0x7f", b"1_000", b"\xd9\xa3", b"1,5", b"true", b"null", b"[]", b"{}", b'"x"',
           b"2262-04-12T00:00:00Z", b"1677-01-01T00:00:00Z", b"99999-01-01", b"12:30:00", b"-62135596800"]  # fmt: skip
TOKENS = [*NUMBERS, b'"', b"'", b"\r", b"\n", b"\r\n", b"\x00", b"\xff", b"\xed\xa0\x80", b"\\ud800", b",", b";", b"\t", b"<", b">",
          b"&", b"<!--", b"-->", b"]]>", b"<![CDATA[", b"{", b"}", b"[", b"]", b"=", b"[[", b"$GPRMC,", b"*00", b"\xb5b\x01\x07",
          b"\xef\xbb\xbf", b"\x1f\x8b", b"PAR1", b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"%", b"\\", b"A" * 5000, b"-" * 300,
          b'"timestamp"', b'"coordinates"', b"e" * 40, b"_file", b"date", b"timestamp", b"vehicle_id"]  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(\.\d+)?")
_TOKEN = re.compile(rb'"[^"]*"|[\w.+-]+')
IMPORTS = 0.2
"""Mutants for a whole import, as a share of those for a reader: it takes ten times as long."""


def mutant(rng: random.Random, data: bytes) -> bytes:
    """The file after one to four changes."""
    for _ in range(rng.randint(1, 4)):
        data = rng.choice(_CHANGES)(rng, data)
    return data


def _span(rng: random.Random, data: bytes, most: int = 64) -> tuple[int, int]:
    a = rng.randrange(len(data) + 1)
    return a, min(len(data), a + 1 + rng.randrange(most))


def _flip(rng: random.Random, data: bytes) -> bytes:
    if not data:
        return data
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]


def _put(rng: random.Random, data: bytes) -> bytes:
    a, b = _span(rng, data, 8)
    return data[:a] + rng.randbytes(b - a) + data[b:]


def _cut(rng: random.Random, data: bytes) -> bytes:
    a, b = _span(rng, data, rng.choice((2, 64, 2000)))
    return data[:a] + data[b:]


def _double(rng: random.Random, data: bytes) -> bytes:
    a, b = _span(rng, data, rng.choice((8, 200)))
    return data[:b] + data[a:b] * rng.choice((1, 1, 20)) + data[b:]


def _insert(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(TOKENS) + data[at:]


def _number(rng: random.Random, data: bytes) -> bytes:
    found = list(_NUMBER.finditer(data))
    if not found:
        return data
    one = rng.choice(found)
    return data[: one.start()] + rng.choice(NUMBERS) + data[one.end() :]


def _token(rng: random.Random, data: bytes) -> bytes:
    """One word, number or quoted text in the place of another: what stays well formed goes deeper."""
    found = list(_TOKEN.finditer(data))
    if len(found) < 2:
        return data
    one, other = rng.sample(found, 2)
    return data[: one.start()] + other[0] + data[one.end() :]


def _swap(rng: random.Random, data: bytes) -> bytes:
    a, b = _span(rng, data)
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[a:b] + data[at:]


def _end(rng: random.Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _clear(rng: random.Random, data: bytes) -> bytes:
    a, b = _span(rng, data, 32)
    return data[:a] + rng.choice((b"\0", b"\xff")) * (b - a) + data[b:]


_CHANGES: list[Callable[[random.Random, bytes], bytes]] = [
    _flip, _flip, _put, _cut, _double, _insert, _insert, _number, _number, _number, _token, _token, _token,
    _swap, _end, _clear,
]  # fmt: skip


def rechecked(data: bytes) -> bytes:
    """NMEA sentences with the checksum of what they have become: past the checksum lies the reader."""

    def mend(found: re.Match[bytes]) -> bytes:
        check = 0
        for byte in found[1]:
            check ^= byte
        return b"$%s*%02X" % (found[1], check)

    return re.sub(rb"\$([^*\r\n]*)\*[0-9A-F]{2}", mend, data)


def targets() -> dict[str, tuple[str, bytes]]:
    """Name of a reader (with a variant): name of the file, and its bytes."""
    more = {n: log for n, log in seeds.MORE_LOGS.items() if find_spec(seeds.EXTRAS.get(n, "fleetlog"))}
    logs = {name: (f"log.{suffix}", make()) for name, (suffix, make) in (seeds.LOGS | more).items()}
    whole = {f"import {name}": log for name, log in logs.items()}
    return logs | whole | {name: (name, data) for name, data in (seeds.MAPS | seeds.SETTINGS).items()}


def finding(name: str, path: Path) -> str | None:
    """What is wrong with the way in which a file is taken; None where nothing is."""
    begin = time.process_time()
    try:
        lines = _lines(name, path)
    except Exception:
        return traceback.format_exc(limit=-4)
    spent = time.process_time() - begin
    fault = next((line for line in lines if "a fault in" in line), None)
    return fault or (f"{spent:.1f} s" if spent > SECONDS else None)


def _lines(name: str, path: Path) -> list[str]:
    if name.startswith("import "):
        return judge.imported(path, path.parent).lines
    if name in seeds.LOGS | seeds.MORE_LOGS:
        return judge.read(path, importer=by_name(name.split()[0])).lines
    if name in seeds.SETTINGS:
        return judge.settings(path).lines
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read_map(path)
        except FleetlogError as error:
            return [error.line()]
    return []


def fuzz(name: str, count: int, seed: int, folder: Path, keep: Path | None = None) -> list[str]:
    """``count`` mutants for one reader; the findings."""
    file, whole = targets()[name]
    path, found = folder / file, []
    (folder / "times.txt").write_bytes(seeds.TIMES)
    for k in range(count):
        rng = random.Random(f"{seed} {name} {k}")
        data = mutant(rng, whole)
        path.write_bytes(rechecked(data) if name == "nmea" and rng.random() < 0.5 else data)
        if what := finding(name, path):
            found.append(f"{name}, seed {seed}, mutant {k}: {what}")
            if keep is not None:
                keep.mkdir(exist_ok=True)
                (keep / f"{seed}-{k}-{path.name}").write_bytes(path.read_bytes())
    return found


def weight(name: str) -> float:
    """How many mutants a target gets, as a share of those of a reader."""
    return IMPORTS if name.startswith("import ") or name == "mf4" else 1.0


def quick_folder() -> str | None:
    """Where a file is written fastest: in memory, where the machine lets one."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def main() -> int:
    """Run from the command line; 1 where anything was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mutants", type=int, default=100_000, help="for all readers together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=sorted(targets()))
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    names = [given.only] if given.only else list(targets())
    total, each = 0, given.mutants / sum(map(weight, names))
    with tempfile.TemporaryDirectory(dir=quick_folder()) as folder:
        for name in names:
            begin = time.perf_counter()
            count = math.ceil(each * weight(name))
            found = fuzz(name, count, given.seed, Path(folder), Path("findings"))
            total += len(found)
            print(
                f"{name:15} {count:6} mutants {len(found):4} findings {time.perf_counter() - begin:7.1f} s",
                flush=True,
            )
            print("".join(f"  {f}\n" for f in found[:5]), end="", flush=True)
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
