"""Record half an hour of eight trucks on the sample plant, each in the format that its maker would have written.

    python make_logs.py

The trucks are those of ``recorder.py``.
"""

from __future__ import annotations

import gzip
import io
import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

from make_plant import geographic
from recorder import Truck, record

HERE = Path(__file__).parent
START = datetime(2026, 3, 2, 6, 0, 0, tzinfo=UTC)
TRUCK = """name = "counterbalance-48V"
[chassis]
mass = 4420.0
rated_load = 2500.0
turn_radius = 2.5
length = 3.2
width = 1.2
[drive]
efficiency = 0.79
regeneration = 0.30
max_power = 18000.0
max_speed = 5.0
speed_factor = 0.92
max_acceleration = 0.6
max_deceleration = 0.8
max_lateral_acceleration = 1.2
[resistance]
rolling = 0.0146
drag_area = 0.0
[lift]
efficiency = 0.65
recuperation = 0.0
carriage_mass = 350.0
raise_speed = 0.35
lower_speed = 0.45
[auxiliary]
power = 470.0
[battery]
voltage = 48.0
capacity_wh = 30000.0
internal_resistance = 0.0
"""


def stamp(t: float) -> str:
    return (START + timedelta(seconds=round(t, 3))).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def write_gz(name: str, text: str) -> None:
    raw = io.BytesIO()
    with gzip.GzipFile(fileobj=raw, mode="wb", mtime=0, compresslevel=9) as stream:
        stream.write(text.encode())
    (HERE / "logs" / name).write_bytes(raw.getvalue())


def write_csv(trucks: list[Truck]) -> None:
    """The fleet's own recorder: fleetlog's column names."""
    rows = [(t, truck.id, r) for truck in trucks for r in truck.rows for t in [r[0]]]
    out = [
        "vehicle_id,timestamp,latitude,longitude,speed,payload,fork_height,battery_power,soc,ambient_temperature"
    ]
    for t, name, r in sorted(rows, key=lambda q: (q[0], q[1])):
        lon, lat = geographic(r[1], r[2])
        out.append(
            f"{name},{stamp(t)},{lat:.8f},{lon:.8f},{r[3]:.2f},{r[4]:.0f},{r[5]:.2f},{r[6]:.0f},{r[7]:.4f},{6 + t / 1200:.1f}"
        )
    out[700:700] = [out[699]] * 3  # a row sent again
    broken = out[2500].split(",")
    broken[2] = f"{float(broken[2]) + 0.01:.8f}"  # a fix one kilometre off
    out[2500] = ",".join(broken)
    write_gz("fleet.csv.gz", "\n".join(out) + "\n")


def write_other_csv(trucks: list[Truck]) -> None:
    """Another maker's export: other names and units, semicolons, a sentinel."""
    out = ["id;time;lat;lon;speed_kmh;payload_kg;fork_height_m;power_kw;SOC [%]"]
    for truck in trucks:
        for i, r in enumerate(truck.rows):
            lon, lat = geographic(r[1], r[2])
            kmh = -3.6 if i % 600 == 599 else r[3] * 3.6
            out.append(
                f"{truck.id};{stamp(r[0])};{lat:.8f};{lon:.8f};{kmh:.1f};{r[4]:.0f};{r[5]:.2f};{r[6] / 1000:.3f};{r[7] * 100:.2f}"
            )
    write_gz("other_maker.csv.gz", "\n".join(out) + "\n")


def write_vda5050(truck: Truck) -> None:
    """State messages of an AGV, version 2.1, one JSON object a line, every two seconds."""
    lines = []
    for i, r in enumerate(truck.rows[::2]):
        state = {
            "headerId": i, "timestamp": stamp(r[0]), "version": "2.1.0", "manufacturer": "sample", "serialNumber": truck.id,
            "driving": r[3] > 0.05, "operatingMode": "AUTOMATIC", "errors": [],
            "agvPosition": {"x": round(r[1], 3), "y": round(r[2], 3), "theta": round(r[8], 4), "mapId": "plant", "positionInitialized": True},
            "velocity": {"vx": round(r[3], 3)},
            "batteryState": {"batteryCharge": round(100 * r[7], 2), "charging": r[9]},
            "loads": [{"weight": round(r[4])}] if r[4] else [],
        }  # fmt: skip
        lines.append(json.dumps(state, separators=(",", ":")))
    write_gz(f"{truck.id}_vda5050.jsonl.gz", "\n".join(lines) + "\n")


def write_nmea(truck: Truck) -> None:
    """RMC and GGA sentences; a few arrive damaged."""
    out = []
    for i, r in enumerate(truck.rows):
        lon, lat = geographic(r[1], r[2])
        when = START + timedelta(seconds=r[0])
        hms = when.strftime("%H%M%S") + f".{when.microsecond // 10000:02d}"
        dm = lambda v, w: f"{int(v):0{w}d}{(v - int(v)) * 60:010.7f}"
        course = math.degrees(math.pi / 2 - r[8]) % 360
        for body in (
            f"GPRMC,{hms},A,{dm(lat, 2)},N,{dm(lon, 3)},E,{r[3] / 0.514444:.2f},{course:.1f},{when:%d%m%y},,,A",
            f"GPGGA,{hms},{dm(lat, 2)},N,{dm(lon, 3)},E,1,11,0.8,132.0,M,47.0,M,,",
        ):
            check = 0
            for c in body:
                check ^= ord(c)
            out.append(f"${body}*{(check + (i in (400, 900, 901))) % 256:02X}\r\n")
    write_gz(f"{truck.id}.nmea.gz", "".join(out))


def write_mcap(truck: Truck) -> None:
    """A robot's bag: NavSatFix and BatteryState of ROS 2."""
    from mcap_ros2.writer import Writer

    time_def = "int32 sec\nuint32 nanosec"
    header = f"\n{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{'=' * 80}\nMSG: builtin_interfaces/Time\n{time_def}"
    fix = (
        "std_msgs/Header header\nNavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
        "float64[9] position_covariance\nuint8 position_covariance_type"
        f"{header}\n{'=' * 80}\nMSG: sensor_msgs/NavSatStatus\nint8 status\nuint16 service"
    )
    battery = (
        "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\nfloat32 capacity\n"
        "float32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\nuint8 power_supply_health\n"
        "uint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\nfloat32[] cell_temperature\nstring location\nstring serial_number"
        f"{header}"
    )
    with (HERE / "logs" / f"{truck.id}.mcap").open("wb") as stream:
        writer = Writer(stream)
        fix_schema = writer.register_msgdef("sensor_msgs/msg/NavSatFix", fix)
        battery_schema = writer.register_msgdef("sensor_msgs/msg/BatteryState", battery)
        for i, r in enumerate(truck.rows):
            lon, lat = geographic(r[1], r[2])
            ns = int((START.timestamp() + round(r[0], 3)) * 1e9)
            head = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": truck.id}
            writer.write_message(f"/{truck.id}/fix", fix_schema, {
                "header": head, "status": {"status": 0, "service": 1}, "latitude": lat, "longitude": lon, "altitude": 132.0,
                "position_covariance": [0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.04], "position_covariance_type": 2}, ns, ns, i)  # fmt: skip
            writer.write_message(f"/{truck.id}/battery", battery_schema, {
                "header": head, "voltage": 48.0, "temperature": 24.0, "current": -r[6] / 48.0, "charge": 0.0, "capacity": 0.0,
                "design_capacity": 0.0, "percentage": r[7], "power_supply_status": 2, "power_supply_health": 1,
                "power_supply_technology": 3, "present": True, "cell_voltage": [], "cell_temperature": [], "location": "", "serial_number": truck.id,
            }, ns, ns, i)  # fmt: skip
        writer.finish()


def main() -> None:
    (HERE / "logs").mkdir(exist_ok=True)
    (HERE / "truck.toml").write_text(TRUCK)
    trucks = record()
    write_csv(trucks[:3])
    write_other_csv(trucks[3:5])
    write_mcap(trucks[5])
    write_vda5050(trucks[6])
    write_nmea(trucks[7])


if __name__ == "__main__":
    main()
