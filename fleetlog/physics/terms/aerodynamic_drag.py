"""Aerodynamic drag in still air."""

from fleetlog.physics.term import AIR_DENSITY, Floats, Motion, Parameter, Term, Truck, Values


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = 1/2 rho c_d A v^2 [N]; c_d A is some 3 to 5 m2 for a counterbalance truck with an upright mast, and
    6 to 10 m2 for a lorry with a trailer (our estimate), of which the bound is twice as much."""
    return 0.5 * AIR_DENSITY * truck.resistance.drag_area * motion.speed**2


TERM = Term(
    "aerodynamic_drag", "force", "air drag is larger than the truck file says",
    (Parameter("drag_area", "m2", 0.0, 20.0, truck_key="resistance.drag_area", tolerance=0.1),), force,
    nominal=True, depends_on=("speed",),
    sentence="Air drag acts on an area (c_d A) of {drag_area.value:.1f} m2 ({drag_area.low:.1f} to "
    "{drag_area.high:.1f}); the truck file has {drag_area.nominal:.1f} m2",
    needs="drive the same road at three speeds, the highest included",
    advice="Enter the drag area in the truck file",
)  # fmt: skip
