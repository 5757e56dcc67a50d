"""The formulas of the terms that come with fleetlog: each is the function of its term's name, and calls no
other one.  What else a term has (numbers, bounds, sentences) stands in terms/terms.toml.

All take a motion of N samples, the truck and the values of the term's parameters, and return (N,) what the
term ``acts`` as; see :class:`fleetlog.physics.term.Term`."""

import numpy as np

from fleetlog.core.arrays import distinct
from fleetlog.physics.term import AIR_DENSITY, GRAVITY, Floats, Motion, Truck, Values, total_mass

LADEN = 25.0  # Less than this on the forks is no load [kg]


def inertia(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = m a [N]; Newton's second law, for a mass without rotating parts (see rotational_inertia)."""
    return total_mass(motion, truck) * motion.acceleration


def rotational_inertia(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = (factor - 1) m a [N]; ``factor`` = 1 + sum(J i^2 / r^2) / m,
    about 1.05 to 1.15 for electric trucks (estimate)."""
    return (values.get("factor", 1.0) - 1.0) * total_mass(motion, truck) * motion.acceleration


def rolling_resistance(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = f m g cos(theta) while rolling, 0 at rest [N]. f is about 0.006 to 0.02 for tyres on asphalt or
    concrete, 0.012 to 0.025 for superelastic tyres; independent of speed below some 10 m/s."""
    pressed = total_mass(motion, truck) * GRAVITY * np.cos(distinct(motion.slope))
    return np.where(motion.speed > 0.0, truck.resistance.rolling * pressed, 0.0)


def surface_resistance(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = (factor - 1) f m g cos(theta) while rolling, 0 at rest [N]; what the floor adds to the truck's own
    rolling.

    ``factor`` is the rolling coefficient here over that of the truck file: about 1.3 on worn asphalt, 2 on
    gravel, 4 on loose ground (worn and loose against new asphalt-concrete: Carvill, Mechanical Engineer's
    Data Handbook)."""
    pressed = total_mass(motion, truck) * GRAVITY * np.cos(distinct(motion.slope))
    extra = (np.asarray(values.get("factor", 1.0)) - 1.0) * truck.resistance.rolling
    return np.where(motion.speed > 0.0, extra * pressed, 0.0)


def grade(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = m g sin(theta) [N], theta the map's slope along the motion and what was found (``slope``: tan)."""
    mapped, found = distinct(motion.slope), values.get("slope", 0.0)
    sine = (np.sin(mapped) + found * np.cos(mapped)) / np.sqrt(1.0 + np.square(found))  # Of both angles
    return np.asarray(total_mass(motion, truck) * GRAVITY * sine)


def aerodynamic_drag(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = 1/2 rho c_d A v^2 [N]; c_d A is some 3 to 5 m2 for a counterbalance truck with an upright mast, and
    6 to 10 m2 for a lorry with a trailer (our estimate), of which the bound is twice as much."""
    return 0.5 * AIR_DENSITY * truck.resistance.drag_area * motion.speed**2


def wind(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = 1/2 rho c_d A (u |u| - v^2) [N], u = v - w.h the air that meets the truck head on; 0 in still air.

    w = (``wind_east``, ``wind_north``) is where the air goes [m/s], h the unit vector of the motion.  Cross
    wind is left out: it pushes sideways.  Added to the drag in still air this is the drag in wind."""
    east, north = values.get("wind_east", 0.0), values.get("wind_north", 0.0)
    u = motion.speed - (east * np.cos(motion.heading) + north * np.sin(motion.heading))
    return 0.5 * AIR_DENSITY * truck.resistance.drag_area * (u * np.abs(u) - motion.speed**2)


def brake_drag(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = ``brake_force`` [N] while rolling, 0 at rest: a brake that rubs, a tight bearing; not by load."""
    return np.where(motion.speed > 0.0, values.get("brake_force", 0.0), 0.0)


def viscous_drag(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = c v [N], ``coefficient`` c in N s/m: churning oil in gears and hubs, eddy currents; not by load."""
    return values.get("coefficient", 0.0) * motion.speed


def cornering_resistance(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = m g k |curvature| while rolling, 0 at rest [N]; ``k`` in metres.

    The part of scrub that remains at walking speed: twin and pivoting wheels are turned on the spot while
    they roll, so work grows with the angle turned, not with speed.  200 to 1000 N in a turn of 2 m radius is
    k of some 0.01 to 0.04 m for a truck of 5 t (our estimate)."""
    scrub = total_mass(motion, truck) * GRAVITY * values.get("k", 0.0) * np.abs(motion.curvature)
    return np.where(motion.speed > 0.0, scrub, 0.0)


def auxiliary_load(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = constant [W]; 150 to 500 W for controller, lights and display."""
    return np.full(len(motion), truck.auxiliary.power)


def enabled_load(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = ``power`` while the truck moves and for ``hold`` seconds after, 0 else [W]. Inverters, brakes held
    open and fans; two real AGVs draw 172 and 72 W so."""
    row, moving = np.arange(len(motion)), motion.speed > 0.0
    last = np.maximum.accumulate(np.where(moving, row, -1))
    first = np.maximum.accumulate(np.where(np.diff(motion.vehicle, prepend=-1) != 0, row, 0))
    on = (last >= first) & (motion.time - motion.time[last] <= values.get("hold", 5.0))
    return np.asarray(values.get("power", 0.0) * on)


def thermal_load(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = heating max(threshold - T, 0) + cooling max(T - threshold, 0) [W]; 0 where the temperature is
    unknown. Newton's law of cooling in the steady state. ``heating`` and ``cooling`` in W/K, ``threshold`` in
    degC. A cabin heater of 1 to 2 kW at 20 K below the threshold is 50 to 100 W/K (our estimate)."""
    above = np.nan_to_num(motion.ambient_temperature - values.get("threshold", 15.0), nan=0.0)
    heating, cooling = values.get("heating", 0.0), values.get("cooling", 0.0)
    return heating * np.maximum(-above, 0.0) + cooling * np.maximum(above, 0.0)


def copper_loss(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = k F^2 [W], F the sum of all forces at the wheel; ``k`` in W/N2.

    Joule heat of a motor current that is proportional to the torque.  A 10 kW drive that loses 4 % at 3 kN
    has k = 4.4e-5 W/N2 (our estimate)."""
    return np.asarray(values.get("k", 0.0) * np.where(motion.speed > 0.0, values["force"], 0.0) ** 2)


def lift_efficiency(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = (payload + carriage) g h' / efficiency raising, times recuperation lowering [W];
    h' = d fork_height / dt."""
    work = (motion.payload + truck.lift.carriage_mass) * GRAVITY * motion.lift_speed
    return np.where(motion.lift_speed > 0.0, work / truck.lift.efficiency, work * truck.lift.recuperation)


def payload(motion: Motion, truck: Truck, values: Values) -> Floats:
    """The payload that acts [kg]: ``factor`` times the recorded one; everything with mass in it follows."""
    return values.get("factor", 1.0) * motion.payload


def cornering_speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """v = sqrt(a_lat / |curvature|) [m/s], inf on straights;
    a_lat of 1 to 1.5 m/s2 is usual for laden trucks (estimate)."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.sqrt(truck.drive.max_lateral_acceleration / np.abs(motion.curvature))


def laden_speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """Where there is a load, ``factor`` times the speed that the road allows (``motion.speed``), but no more
    than the share ``top`` of the truck's top speed and ``turns`` of its speed in turns; else inf [m/s]."""
    cap = np.minimum(values.get("factor", 1.0) * motion.speed, values.get("top", 1.0) * truck.drive.max_speed)
    if "turns" in values:
        bend = np.maximum(np.abs(motion.curvature), 1e-9)
        cap = np.minimum(cap, values["turns"] * np.sqrt(truck.drive.max_lateral_acceleration / bend))
    return np.where(motion.payload > LADEN, cap, np.inf)


def speed_zone(motion: Motion, truck: Truck, values: Values) -> Floats:
    """v = factor times the speed that the road allows (``motion.speed``) [m/s]."""
    return values.get("factor", 1.0) * motion.speed
