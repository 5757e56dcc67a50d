"""Findings in sentences that a fleet engineer understands."""

from __future__ import annotations

from typing import Any

from fleetlog.discovery.finding import Parameter

UNITS = {
    "1": "",
    "W": " W",
    "ohm": " ohm",
    "s": " s",
    "m/s2": " m/s²",
    "N s/m": " N s/m",
    "m2": " m²",
    "W/K": " W/K",
    "m": " m",
    "m/s": " m/s",
    "degC": " °C",
}

SAYS = {
    "grade": "The road climbs or falls by up to {max_grade:.1%} {where}, where the model drives level",
    "surface_resistance": "The floor rolls {factor:.2f} times as hard as the truck file says {where}, in both directions",
    "rolling_resistance": "Tyres roll with a coefficient of {coefficient:.4f} everywhere, against {nominal:.4f} in the truck file",
    "aerodynamic_drag": "Air drag acts on {drag_area:.1f} m², against {nominal:.1f} m² in the truck file",
    "wind": "A steady wind of {speed:.1f} m/s blows towards {towards}",
    "cornering_resistance": "Turning costs extra force (k = {k:.3f} m), as tyres scrub",
    "viscous_drag": "A drag of {coefficient:.0f} N for every m/s of speed is missing, as of oil in gears",
    "rotational_inertia": "Setting off takes the energy of {factor:.2f} times the weighed mass, as of rotating parts",
    "payload": "The true load is {factor:.2f} times the recorded one",
    "drivetrain_efficiency": "The drive turns {efficiency:.1%} of battery energy into motion, against {nominal:.1%} in the truck file",
    "regeneration": "Braking returns {regeneration:.1%} of the braking work, against {nominal:.1%} in the truck file",
    "lift_efficiency": "The hydraulic lift has an efficiency of {efficiency:.1%}, against {nominal:.1%} in the truck file",
    "auxiliary_load": "Constant consumers draw {power:.0f} W, driving or standing, against {nominal:.0f} W in the truck file",
    "thermal_load": "Heating or cooling follows the outside temperature, about a threshold near {threshold:.0f} °C",
    "battery_resistance": "The battery loses energy inside with the square of the current, as {resistance:.4f} ohm would",
    "speed_zone": "Trucks drive at {factor:.0%} of the speed that the map allows {where}",
    "cornering_speed": "Trucks take turns at {lateral_acceleration:.2f} m/s² sideways, against {nominal:.2f} in the truck file",
    "laden_speed": "With a load trucks drive at {factor:.0%} of the speed that they drive without",
    "acceleration_limit": "Trucks gather speed at {acceleration:.2f} m/s², against {nominal:.2f} in the truck file",
    "waiting": "Trucks stand for {seconds:.0f} s on the way {where}, where the simulation drives through",
    "clock_offset": "The power channel runs {offset:+.2f} s behind the positions: the clocks of the two loggers disagree",
    "speed_scale": "The speed channel reads {factor:.3f} times the true speed",
}  # fmt: skip

COMPASS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")

PEOPLE = {
    "x": "place", "y": "", "heading": "direction of travel", "ambient_temperature": "outside temperature", "soc": "state of charge",
    "time": "hour of the day", "time since start": "time since the truck set out", "payload": "load", "speed": "speed",
    "acceleration": "acceleration", "curvature": "turning", "lift_speed": "lifting", "fork_height": "fork height",
    "vehicle_id": "vehicle", "day": "day", "trip_id": "trip", "standing": "standing", "battery_power": "battery power",
}  # fmt: skip

NEEDS = {
    frozenset(
        {"grade", "surface_resistance"}
    ): "drive these roads in the other direction too, or survey their elevation",
    frozenset({"auxiliary_load", "thermal_load"}): "record days of different outside temperature",
    frozenset({"payload", "rotational_inertia"}): "weigh a few loads, or record trips without a load",
    frozenset(
        {"rolling_resistance", "drivetrain_efficiency"}
    ): "let a truck coast to a stop, with and without a load",
    frozenset({"rolling_resistance", "viscous_drag"}): "drive the same road at half speed and at full speed",
    frozenset(
        {"viscous_drag", "aerodynamic_drag"}
    ): "drive the same road at three speeds, the highest included",
    frozenset({"wind", "grade"}): "record the same roads on another, calm day",
    frozenset({"auxiliary_load", "grade"}): "record the same roads at another time",
    frozenset({"rotational_inertia", "drivetrain_efficiency"}): "drive at steady speed for some minutes",
    frozenset({"cornering_speed", "speed_zone"}): "look at turns outside these roads",
}


def needs(term: str, others: list[str]) -> str | None:
    """What recording would tell a term from those that are not excluded."""
    if not others:
        return None
    known = [NEEDS[frozenset({term, o})] for o in others if frozenset({term, o}) in NEEDS]
    return (
        "; ".join(dict.fromkeys(known))
        or f"record what changes {term.replace('_', ' ')} but not {', '.join(o.replace('_', ' ') for o in others)}"
    )


def place(where: dict[str, Any] | None) -> str:
    """On which roads, in a few words."""
    if not where:
        return "everywhere"
    roads = list(dict.fromkeys(e["edge_id"].removeprefix("-") for e in where.get("edges", [])))
    if not roads:
        low_x, low_y, high_x, high_y = where["extent"]
        return f"between x = {low_x:.0f} and {high_x:.0f} m, y = {low_y:.0f} and {high_y:.0f} m"
    named = ", ".join(roads[:3])
    return f"on {named}" + (f" and {len(roads) - 3} more roads" if len(roads) > 3 else "")


def statement(
    term: str, parameters: list[Parameter], where: dict[str, Any] | None, nominal: float | None
) -> str:
    """One sentence; a term of the user's own gets a plain one."""
    numbers: dict[str, Any] = {p.name: p.value for p in parameters}
    if term == "wind" and {"wind_east", "wind_north"} <= set(numbers):
        import math

        east, north = numbers["wind_east"], numbers["wind_north"]
        numbers["speed"] = math.hypot(east, north)
        numbers["towards"] = COMPASS[round(math.atan2(north, east) / (math.pi / 4)) % 8]
    numbers.update(where=place(where), nominal=nominal if nominal is not None else float("nan"))
    template = SAYS.get(term)
    if template is None:
        values = ", ".join(f"{p.name} = {p.value:.4g} {p.unit}" for p in parameters)
        return f"{term.replace('_', ' ')}: {values}"
    try:
        return template.format(**numbers)
    except KeyError:
        return template.split("{")[0].strip()


def follows(depends_on: tuple[str, ...]) -> str:
    """What a mismatch follows, in words."""
    said = [PEOPLE.get(d, d) for d in depends_on]
    return " and ".join(s for s in said if s)


def unknown(name: str, depends_on: tuple[str, ...], when: dict[str, Any] | None) -> tuple[str, str]:
    """Statement and need of a mismatch that no term explains; ``when`` has what each trip or day has of its own."""
    what = follows(depends_on)
    if not when:
        text = f"Something that none of the known terms explains follows {what}"
        return text, f"a term of your own for what follows {what}, or a recording that varies it more"
    (classes,) = when.values()
    values = [v[0] for v in classes.values()]
    low, high = min(values), max(values)
    thing, size = (
        ("Resistance to driving", f"{low:+.3f} to {high:+.3f} of the weight")
        if name.startswith("force")
        else ("The power drawn", f"{low:+.0f} to {high:+.0f} W")
    )
    text = f"{thing} differs from {what} to {what} ({size}, against the model), by something that is not in the log"
    return text, f"record what differed between these {what}s: floor, load, tyres, weather"
