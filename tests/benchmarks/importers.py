"""Rows per CPU second of every log importer, beside the readers that people use otherwise.  Prints a table.

Run it as ``python tests/benchmarks/importers.py [rows]``.  Peers that are not installed are left out.  The peers give objects or
dictionaries; fleetlog gives checked columns in SI units, so the comparison is of what a user waits for, not of equal work.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "importers"))

from log_reading import read_log

START = 1_772_431_200


def write_gpx(path: Path, n: int) -> None:
    with path.open("w") as out:
        out.write('<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>\n')
        for i in range(n):
            stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(START + i))
            out.write(
                f'<trkpt lat="{49.9 + i * 1e-7:.7f}" lon="9.1"><ele>100.0</ele><time>{stamp}</time></trkpt>\n'
            )
        out.write("</trkseg></trk></gpx>\n")


def write_nmea(path: Path, n: int) -> None:
    """Two sentences a row, RMC and GGA."""
    with path.open("w", newline="") as out:
        for i in range(n):
            stamp = time.strftime("%H%M%S", time.gmtime(START + i))
            day = time.strftime("%d%m%y", time.gmtime(START + i))
            for body in (f"GPRMC,{stamp}.00,A,4954.0000,N,00906.0000,E,1.0,90.0,{day},,,A",
                         f"GPGGA,{stamp}.00,4954.0000,N,00906.0000,E,1,08,0.9,100.0,M,47.0,M,,"):  # fmt: skip
                check = 0
                for c in body.encode():
                    check ^= c
                out.write(f"${body}*{check:02X}\r\n")


def write_mcap(path: Path, n: int) -> None:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(
            "/T1/fix", "json", writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
        )
        for i in range(n):
            text = json.dumps(
                {
                    "timestamp": {"sec": START + i, "nsec": 0},
                    "latitude": 49.9,
                    "longitude": 9.1,
                    "altitude": 1.0,
                }
            )
            writer.add_message(channel, (START + i) * 10**9, text.encode(), 0)
        writer.finish()


def write_ros2(path: Path, n: int) -> None:
    from test_recordings import write_ros2 as write

    write(path, {"/T1/odom": "nav_msgs/msg/Odometry"}, n)


def write_vda5050(path: Path, n: int) -> None:
    with path.open("w") as out:
        for i in range(n):
            stamp = time.strftime("%Y-%m-%dT%H:%M:%S.000Z", time.gmtime(START + i))
            out.write(json.dumps({
                "headerId": i, "timestamp": stamp, "version": "2.0.0", "manufacturer": "KIT", "serialNumber": "1",
                "agvPosition": {"x": 1.0, "y": 2.0, "theta": 0.5, "mapId": "m", "positionInitialized": True},
                "velocity": {"vx": 1.0}, "batteryState": {"batteryCharge": 80.0, "charging": False}, "loads": []}) + "\n")  # fmt: skip


def write_tum(path: Path, n: int) -> None:
    path.write_text("".join(f"{START + i}.5 {i} 2.0 0.0 0 0 0 1\n" for i in range(n)))


def write_fcd(path: Path, n: int) -> None:
    with path.open("w") as out:
        out.write("<fcd-export>\n")
        for i in range(n):
            out.write(
                f'<timestep time="{i}.00"><vehicle id="v" x="{i}.00" y="2.00" angle="90.00" speed="1.0" lane="e_0" pos="1.0"/></timestep>\n'
            )
        out.write("</fcd-export>\n")


def write_geojson(path: Path, n: int) -> None:
    with path.open("w") as out:
        out.write('{"type": "FeatureCollection", "features": [')
        for i in range(n):
            stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(START + i))
            point = {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [9.1, 49.9]},
                "properties": {"time": stamp, "speed": 1.0},
            }
            out.write(("," if i else "") + json.dumps(point))
        out.write("]}")


def write_parquet(path: Path, n: int) -> None:
    import numpy as np
    import pandas as pd

    stamps = pd.to_datetime(START + np.arange(n), unit="s", utc=True)
    pd.DataFrame(
        {"timestamp": stamps, "latitude": 49.9, "longitude": 9.1, "speed": 1.0, "vehicle_id": "T1"}
    ).to_parquet(path)


def peer_gpxpy(path: Path) -> None:
    import gpxpy

    gpxpy.parse(path.read_text())


def peer_pynmeagps(path: Path) -> None:
    from pynmeagps import NMEAReader

    with path.open("rb") as stream:
        for _ in NMEAReader(stream):
            pass


def peer_mcap(path: Path) -> None:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages():
            json.loads(message.data)


def peer_ros2(path: Path) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        for _ in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            pass


Peer = tuple[str, Callable[[Path], None]] | None
CASES: dict[str, tuple[str, Callable[[Path, int], None], Peer]] = {
    "gpx": (".gpx", write_gpx, ("gpxpy", peer_gpxpy)),
    "nmea (2 sentences a row)": (".nmea", write_nmea, ("pynmeagps", peer_pynmeagps)),
    "mcap, JSON LocationFix": (".mcap", write_mcap, ("mcap + json", peer_mcap)),
    "mcap, ROS 2 Odometry": (".mcap", write_ros2, ("mcap-ros2-support", peer_ros2)),
    "vda5050": (".jsonl", write_vda5050, None), "tum": (".tum", write_tum, None), "sumo-fcd": (".xml", write_fcd, None),
    "geojson": (".geojson", write_geojson, None), "parquet": (".parquet", write_parquet, None),
}  # fmt: skip


def rate(n: int, work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return n / (time.process_time() - begin)


def main(n: int = 50_000) -> None:
    print(f"{n:,} rows, rows per CPU second\n{'format':28s}{'fleetlog':>12s}  peer")
    for name, (suffix, write, peer) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"log{suffix}"
            write(path, n)
            read = read_log(path)  # warm: imports are not measured
            assert read.rows == n, (name, read.rows, read.rejects)
            line = f"{name:28s}{rate(n, lambda p=path: read_log(p)):12,.0f}"
            if peer is not None:
                try:
                    line += f"  {peer[0]} {rate(n, lambda p=path, w=peer[1]: w(p)):,.0f}"
                except ImportError:
                    line += f"  {peer[0]} is not installed"
            print(line, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50_000)
