"""Trucks as rigid bodies: MuJoCo drives what was planned, and power is what its driven wheels take.

Nothing computes the force of inertia, of a slope or of rolling: they come out of bodies, contacts and joints.
Air drag and what an effect adds push the chassis.  The truck has a driven axle in front and a steered wheel
behind, and is held to its plan by a driver who sees how far it is off.  Nothing of fleetlog is used here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from power import AIR, GRAVITY, HZ, Motion, coefficients, supplied
from trucks import Truck

if TYPE_CHECKING:
    from world import World

SUBSTEPS = 10
"""Steps of the engine a tick."""
RADIUS, BASE, TRACK = 0.3, 1.6, 1.0
"""Radius of the wheels, from axle to axle, between the driven wheels [m]."""
WHEEL, STEERING = 45.0, 20.0
"""Mass of a wheel, and of what steers the rear one [kg]."""
BORNE = np.array([0.25, 0.25, 0.5])
"""Share of the weight on the left, right and rear wheel."""
STRONGEST = 4000.0
"""Torque on each driven wheel [N m]."""
STIFF, STRAIGHT, EAGER, HASTE = 0.25, 1.0, 3.0, 0.8
"""How drivers correct: bend for a metre beside the path and for a radian off it, acceleration for a m/s too
slow, speed for a metre behind."""
REST = 2.0
"""Seconds of standing after which the engine waits for the next drive."""
BODY = f"""
<mujoco>
  <option timestep="{1.0 / HZ / SUBSTEPS}" integrator="implicitfast" cone="elliptic" impratio="100"/>
  <default><geom friction="0.9 0.003 0" condim="4" solref="0.01 1"/><joint axis="0 1 0"/></default>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body name="chassis" pos="0 0 {RADIUS}">
      <freejoint/>
      <inertial pos="{-BASE / 2} 0 0.4" mass="MASS" diaginertia="ROLL YAW YAW"/>
      <body pos="0 {TRACK / 2} 0"><joint name="left" frictionloss="1"/>
        <geom type="ellipsoid" size="{RADIUS} 0.08 {RADIUS}" mass="{WHEEL}"/></body>
      <body pos="0 {-TRACK / 2} 0"><joint name="right" frictionloss="1"/>
        <geom type="ellipsoid" size="{RADIUS} 0.08 {RADIUS}" mass="{WHEEL}"/></body>
      <body pos="{-BASE} 0 0"><joint name="steer" axis="0 0 1" damping="200"/>
        <inertial pos="0 0 0" mass="{STEERING}" diaginertia="2 2 2"/>
        <body><joint name="rear" frictionloss="1"/>
          <geom type="ellipsoid" size="{RADIUS} 0.08 {RADIUS}" mass="{WHEEL}"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="left"/><motor joint="right"/><position joint="steer" kp="60000" kv="2000"/>
  </actuator>
</mujoco>
"""


def drive(w: World, m: Motion, own: Truck, vehicle: int) -> tuple[Motion, np.ndarray, np.ndarray]:
    """The motion that the engine makes of a plan, and power at the terminals and in the cell [W]."""
    c = coefficients(m, own, w.effects, vehicle, w.truck)
    c = {k: np.broadcast_to(np.asarray(v, float), len(m)) for k, v in c.items() if k != "kind"}
    ridden = Ride(m, c).whole()
    x, y, heading, speed, wheel, force = ridden.T
    v = np.where(m.v > 0.0, np.maximum(speed, 1e-3), 0.0)
    bend = np.where(v > 0.4, np.gradient(heading) * HZ / np.maximum(v, 0.4), 0.0)
    moved = replace(m, x=x, y=y, heading=heading, v=v, bend=bend)
    return moved, *supplied(m, c, m.load * c["payload"], _drawn(wheel, force, speed, c))


def _drawn(wheel: np.ndarray, force: np.ndarray, speed: np.ndarray, c: dict[str, Any]) -> np.ndarray:
    """Power that the drive takes [W]: its efficiency varies by some per cent with pull and speed."""
    share = 1.02 - 0.05 * np.minimum(np.abs(force) / 6000.0, 1.0) ** 2 - 0.04 * np.exp(-np.abs(speed) / 0.8)
    taken = wheel / (c["efficiency"] * share) * c["factor"]
    return np.where(wheel > 0, taken, wheel * c["regeneration"] * share) + c["copper"] * force**2


@dataclass
class Ride:
    """One truck-day in the engine: the plan, and the truck's numbers ``c`` at every tick."""

    m: Motion
    c: dict[str, Any]

    @cached_property
    def engine(self) -> Any:
        """MuJoCo, which only these recordings need."""
        import mujoco

        return mujoco

    def whole(self) -> np.ndarray:
        """(n, 6) position, heading, speed, power at the driven wheels and their pull, at every tick."""
        mass = float(self.c["mass"][0]) - 3 * WHEEL - STEERING
        text = (
            BODY.replace("MASS", f"{mass}").replace("ROLL", f"{0.5 * mass}").replace("YAW", f"{0.9 * mass}")
        )
        self.model = self.engine.MjModel.from_xml_string(text)
        self.data = self.engine.MjData(self.model)
        self.driven = [int(self.model.joint(k).qposadr[0]) for k in ("left", "right")]
        self.turning = [int(self.model.joint(k).dofadr[0]) for k in ("left", "right", "rear")]
        self.empty = mass, self.model.body("chassis").inertia.copy()
        self.ahead = np.gradient(self.m.v) * HZ
        self.loaded = float("nan")
        resting = _resting(self.m.v)
        out = np.zeros((len(self.m), 6))
        self.put(0)
        for k in range(len(self.m)):
            if resting[k]:
                out[k] = [*(out[k - 1] if k else self.at(0.0))[:3], 0.0, 0.0, 0.0]
                continue
            if k and resting[k - 1]:
                self.put(k)
            before = self.data.qpos[self.driven].copy()
            self.push(k)
            self.engine.mj_step(self.model, self.data, SUBSTEPS)
            torque, turned = self.data.ctrl[:2], self.data.qpos[self.driven] - before
            near = self.m.heading[k]
            out[k] = [*self.at(near), torque @ turned * HZ, torque.sum() / RADIUS]
        return out

    def at(self, near: float) -> tuple[float, float, float, float]:
        """Position, heading on the turn ``near`` which the plan is, and speed along it."""
        w, x, y, z = self.data.qpos[3:7]
        yaw = float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        yaw += 2 * np.pi * round((near - yaw) / (2 * np.pi))
        speed = self.data.qvel[0] * np.cos(yaw) + self.data.qvel[1] * np.sin(yaw)
        return float(self.data.qpos[0]), float(self.data.qpos[1]), yaw, float(speed)

    def put(self, k: int) -> None:
        """Stand where the plan goes on: a new trip may begin in another direction."""
        m, q = self.m, self.data.qpos
        q[:] = 0.0
        q[:3] = m.x[k], m.y[k], RADIUS
        q[3], q[6] = np.cos(m.heading[k] / 2), np.sin(m.heading[k] / 2)
        self.data.qvel[:] = 0.0
        self.engine.mj_forward(self.model, self.data)

    def push(self, k: int) -> None:
        """Set what acts during a tick: weight, floor, slope, air, and what the driver does."""
        m, c, data = self.m, self.c, self.data
        mass = float(c["mass"][k] + m.load[k] * c["payload"][k])
        if mass != self.loaded:
            self.weigh(mass)
        _, _, yaw, v = self.at(m.heading[k])
        cos, sin = np.cos(yaw), np.sin(yaw)
        slope = float(m.slope[k] + c["slope"][k])
        self.model.opt.gravity[:] = -GRAVITY * slope * cos, -GRAVITY * slope * sin, -GRAVITY
        self.model.dof_frictionloss[self.turning] = BORNE * RADIUS * c["rolling"][k] * mass * GRAVITY
        self.model.dof_armature[self.turning[:2]] = (c["inertia"][k] - 1.0) * mass * RADIUS**2 / 2.0
        self.model.dof_damping[self.turning[:2]] = c["viscous"][k] * RADIUS**2 / 2.0
        air = v - c["east"][k] * cos - c["north"][k] * sin
        drag = 0.5 * AIR * c["drag_area"][k] * air * abs(air) + c["force"][k]
        drag += mass * GRAVITY * c["scrub"][k] * abs(m.bend[k])
        drag *= min(max(v, 0.0) / 0.1, 1.0)
        data.xfrc_applied[1, :2] = -drag * cos, -drag * sin
        behind, beside = self.off(k)
        self.steer(k, yaw, beside)
        wanted = max(m.v[k] + HASTE * float(np.clip(behind, -0.5, 0.5)) + self.ahead[k] / HZ, 0.0)
        pull = mass * (self.ahead[k] + EAGER * (wanted - v) + GRAVITY * (c["rolling"][k] + slope)) + drag
        data.ctrl[:2] = np.clip(pull * RADIUS / 2.0, -STRONGEST, STRONGEST)

    def off(self, k: int) -> tuple[float, float]:
        """How far the truck is behind the plan, and to the right of it [m]."""
        dx, dy = self.m.x[k] - self.data.qpos[0], self.m.y[k] - self.data.qpos[1]
        cos, sin = np.cos(self.m.heading[k]), np.sin(self.m.heading[k])
        return float(dx * cos + dy * sin), float(-dx * sin + dy * cos)

    def steer(self, k: int, yaw: float, beside: float) -> None:
        """Turn the rear wheel for the bend of the path, and back to it."""
        bend = self.m.bend[k] + STIFF * beside + STRAIGHT * (self.m.heading[k] - yaw)
        self.data.ctrl[2] = -np.arctan(BASE * np.clip(bend, -0.6, 0.6))

    def weigh(self, mass: float) -> None:
        """Take up or put down a load."""
        frame, inertia = self.empty
        own = mass - 3 * WHEEL - STEERING
        at, going = self.data.qpos.copy(), self.data.qvel.copy()
        self.model.body_mass[1], self.model.body_inertia[1] = own, inertia * own / frame
        self.engine.mj_setConst(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = at, going
        self.loaded = mass


def _resting(v: np.ndarray) -> np.ndarray:
    """Where a truck has stood for a while and goes on standing."""
    at = np.arange(len(v))
    last = np.maximum.accumulate(np.where(v > 0.0, at, -(10**9)))
    return at - last > REST * HZ
