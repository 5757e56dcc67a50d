"""A truck: what the nominal model needs to know of a vehicle type; every key but mass has a default."""

from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from fleetlog.core.schema import anything, load_toml, real, rows, table, text, whole
from fleetlog.errors import TruckError, nearest


def _key(default: Any, unit: str, meaning: str, low: float = 0.0, high: float = 1e9) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "low": low, "high": high})


@dataclass(frozen=True)
class Chassis:
    """Mass and shape."""

    mass: float = _key(MISSING, "kg", "with battery, without load", 1.0, 1e5)
    rated_load: float = _key(2500.0, "kg", "heaviest load that may be lifted")
    turn_radius: float = _key(2.5, "m", "paths are rounded with this radius at junctions")
    length: float = _key(3.0, "m", "of the footprint, forks included", 0.1, 30.0)
    width: float = _key(1.2, "m", "of the footprint", 0.1, 10.0)


@dataclass(frozen=True)
class Drive:
    """Traction and what the driver asks of it."""

    efficiency: float = _key(0.80, "1", "battery to wheel", 1e-3, 1.0)
    regeneration: float = _key(0.30, "1", "wheel to battery, share of braking work", 0.0, 1.0)
    max_power: float = _key(18000.0, "W", "at the wheel")
    max_speed: float = _key(5.0, "m/s", "on level ground", 1e-3)
    speed_factor: float = _key(1.0, "1", "share of the limit that drivers use", 1e-3, 2.0)
    max_acceleration: float = _key(0.6, "m/s2", "setting off", 1e-3)
    max_deceleration: float = _key(0.8, "m/s2", "braking", 1e-3)
    max_lateral_acceleration: float = _key(1.2, "m/s2", "in turns", 1e-3)
    reaction: float = _key(0.0, "s", "after which drivers set off or brake behind another truck", 0.0, 10.0)


@dataclass(frozen=True)
class Resistance:
    """Forces against motion."""

    rolling: float = _key(0.015, "1", "rolling coefficient", 0.0, 1.0)
    drag_area: float = _key(0.0, "m2", "c_d A")


@dataclass(frozen=True)
class Lift:
    """The mast."""

    efficiency: float = _key(0.65, "1", "battery to raised load", 1e-3, 1.0)
    recuperation: float = _key(0.0, "1", "share of the lowering work returned", 0.0, 1.0)
    carriage_mass: float = _key(350.0, "kg", "lifted with every load")
    raise_speed: float = _key(0.35, "m/s", "raising", 1e-3)
    lower_speed: float = _key(0.45, "m/s", "lowering", 1e-3)


@dataclass(frozen=True)
class Auxiliary:
    """Whatever is on while the key is on."""

    power: float = _key(400.0, "W", "controller, lights, display")


@dataclass(frozen=True)
class Battery:
    """The traction battery."""

    voltage: float = _key(48.0, "V", "nominal", 1.0)
    capacity_wh: float = _key(30000.0, "Wh", "usable energy", 1.0)
    internal_resistance: float = _key(0.0, "ohm", "at the terminals")


@dataclass(frozen=True)
class Truck:
    """The nominal truck; every analysis and the simulator read this and nothing else of a vehicle type."""

    chassis: Chassis
    name: str = "truck"
    drive: Drive = Drive()
    resistance: Resistance = Resistance()
    lift: Lift = Lift()
    auxiliary: Auxiliary = Auxiliary()
    battery: Battery = Battery()
    others: tuple[tuple["Truck", int], ...] = ()
    """Trucks of other types that are simulated beside it, and how many of each."""

    def with_value(self, key: str, value: float) -> "Truck":
        """A copy with one dotted key changed, as ``drive.efficiency``."""
        section, name = key.split(".")
        return replace(self, **{section: replace(getattr(self, section), **{name: value})})

    def value(self, key: str) -> float:
        """The value of a dotted key, as ``drive.efficiency``."""
        section, name = key.split(".")
        return float(getattr(getattr(self, section), name))


SECTIONS: dict[str, Any] = {f.name: f.type for f in fields(Truck) if is_dataclass(f.type)}


@dataclass(frozen=True)
class Watched(Truck):
    """A truck that notes which of its sections are read."""

    read: set[str] = field(default_factory=set, init=False, compare=False)

    def __getattribute__(self, name: str) -> Any:
        if name in SECTIONS:
            super().__getattribute__("read").add(name)
        return super().__getattribute__(name)


PRESETS = Path(__file__).parents[1] / "physics" / "presets"
"""Folder of the trucks that come with fleetlog; every number's source stands in the file."""


def preset_names() -> list[str]:
    """Names of the trucks that come with fleetlog."""
    return sorted(p.stem for p in PRESETS.glob("*.toml"))


def load_truck(path: str | Path) -> Truck:
    """Read a truck file (TOML) or a preset by its name; :class:`TruckError` names the key at fault."""
    data, file = _tables(str(path), Path())
    keys = {"truck": text, "count": whole(1, 100_000)}
    fleet = rows({"fleet": data.pop("fleet", [])}, "fleet", keys, file, keys, TruckError)
    others = ((truck_from_dict(*_tables(row["truck"], file.parent)), row["count"]) for row in fleet)
    return replace(truck_from_dict(data, file), others=tuple(others))


def _tables(name: str, folder: Path) -> tuple[dict[str, Any], Path]:
    """What a truck file, or the preset of that name, holds; and where it stands."""
    path = folder / name
    if not path.exists() and name in preset_names():
        path = PRESETS / f"{name}.toml"
    do = f"give a truck file or a preset: {nearest(path.name, preset_names())}"
    return load_toml(path, TruckError, do), path


def truck_from_dict(data: dict[str, Any], where: str | Path | None = None) -> Truck:
    """A truck of nested sections, checked."""
    top = table(data, {"name": text, **dict.fromkeys(SECTIONS, anything)}, where, "", error=TruckError)
    made = {}
    for name, kind in SECTIONS.items():
        keys = {f.name: real(*(f.metadata[k] for k in ("low", "high", "unit"))) for f in fields(kind)}
        needed = [f.name for f in fields(kind) if f.default is MISSING]
        made[name] = kind(**table(data.get(name, {}), keys, where, name, needed, TruckError))
    return Truck(name=top.get("name", "truck"), **made)


def truck_to_dict(truck: Truck) -> dict[str, Any]:
    """Nested sections, as in the file."""
    return {"name": truck.name, **{section: asdict(getattr(truck, section)) for section in SECTIONS}}
