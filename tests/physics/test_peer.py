"""The same drive cycle through FASTSim, the vehicle simulator of the U.S. National Renewable Energy Laboratory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Auxiliary, Chassis, Drive, Resistance, Truck
from fleetlog.physics.power import Physics, battery_power, term_forces

fastsim = pytest.importorskip("fastsim", reason="FASTSim (pip install fastsim) is not here")

Z = "veh.pt_type.BEV."


def history(cycle: str) -> tuple[Any, dict[str, np.ndarray]]:
    """A battery electric car of FASTSim's own driven through one of its own cycles."""
    car = fastsim.Vehicle.from_resource("2022_Renault_Zoe_ZE50_R135.yaml")
    car.set_save_interval(1)
    drive = fastsim.SimDrive(car, fastsim.Cycle.from_resource(cycle))
    drive.run()
    frame = drive.to_dataframe()
    column = {
        c.removeprefix("veh.").replace("history.", ""): frame[c].to_numpy()
        for c in frame.columns
        if "history" in c
    }
    return car.to_dict(), column


@pytest.mark.parametrize("cycle", ["udds.csv", "hwfet.csv"])
def test_forces_and_energy_agree_with_fastsim(cycle: str) -> None:
    car, h = history(cycle)
    shape = car["chassis"]
    v, t = h["speed_ach_meters_per_second"], np.arange(len(h["speed_ach_meters_per_second"]), dtype=float)
    mass = float(h["mass_kilograms"][-1])
    # The wheels of FASTSim are spun up with the car: the same as a rotating-mass factor.
    wheels = (
        shape["num_wheels"]
        * shape["wheel_inertia_kilogram_square_meters"]
        / shape["wheel_radius_meters"] ** 2
    )
    push = np.maximum(np.diff(h["energy_tractive_joules"]), 0.0).sum()
    pull = np.minimum(np.diff(h["energy_tractive_joules"]), 0.0).sum()
    electric = np.diff(h["pt_type.BEV.em.energy_elec_prop_in_joules"])
    # Its motor has an efficiency map, ours one number: that of its own mean over the cycle.
    # Its air is thinner than our 1.2 kg/m3 (the cycle's height and temperature): read back from its drag, step by step.
    area = shape["drag_coef"] * shape["frontal_area_square_meters"]
    middle = 0.5 * (v[1:] + v[:-1])
    density = np.diff(h["energy_drag_joules"])[middle > 5] / (0.5 * area * middle[middle > 5] ** 3)
    assert np.ptp(density) < 1e-9 and 1.1 < density[0] < 1.2
    truck = Truck(
        Chassis(mass), "zoe",
        Drive(
            efficiency=push / np.maximum(electric, 0.0).sum(), regeneration=np.minimum(electric, 0.0).sum() / pull
        ),
        Resistance(shape["wheel_rr_coef"], area * float(density[0]) / 1.2),
        auxiliary=Auxiliary(car["pwr_aux_base_watts"]),
    )  # fmt: skip
    physics = Physics(truck, {"rotational_inertia": {"factor": 1.0 + wheels / mass}})
    dt = np.diff(t)
    motion = Motion.of(len(dt), time=t[1:], dt=dt, speed=middle, acceleration=np.diff(v) / dt)
    work = {name: float((force * motion.speed) @ dt) for name, force in term_forces(motion, physics).items()}

    # Term by term at the wheel; its free fall is 9.80 m/s2.
    assert work["rolling_resistance"] == pytest.approx(h["energy_rr_joules"][-1] * 9.81 / 9.80, rel=1e-4)
    assert work["aerodynamic_drag"] == pytest.approx(h["energy_drag_joules"][-1], rel=1e-6)
    assert abs(work["inertia"]) < 1.0 and abs(h["energy_accel_joules"][-1]) < 1.0
    # ... and at the battery.
    ours = float(battery_power(motion, physics) @ dt)
    theirs = float(h["pt_type.BEV.res.energy_out_electrical_joules"][-1])
    assert ours == pytest.approx(theirs, rel=0.005)
