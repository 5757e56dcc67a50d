"""Energy used and charged as the log's electrical channels give it, by truck and quarter of an hour.

Power is held from each row to the next; a silence longer than ``MAX_GAP`` counts nothing.  What flows into
the battery while the truck is charged is charged energy, everything else is used (braking returns some).
"""

import numpy as np
import pandas as pd

from fleetlog.analysis.energybook.book import measured_power
from fleetlog.analysis.utilisation import COLUMNS, QUARTER, STATES, joined_days, row_states, stamps
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP

KWH = 3.6e6
KEYS = ["vehicle_id", "start"]
ELECTRICAL = ("battery_voltage", "battery_current")


def consumption(dataset: Dataset) -> pd.DataFrame:
    """One row a truck and quarter of an hour: vehicle_id, start, and sums.

    ``seconds`` and ``metres`` of the log, ``measured_s`` and ``measured_m`` of these with a known power, and
    ``used_kwh`` and ``charged_kwh`` in that time.
    """
    days = [_quarters(t) for t in joined_days(dataset, (*COLUMNS, *ELECTRICAL))]
    return pd.concat(days).groupby(KEYS, as_index=False).sum()


def _quarters(t: Trajectory) -> pd.DataFrame:
    step = np.diff(t.time, append=t.time[-1:]) * 1e-6
    dt = np.where(step <= MAX_GAP, step, 0.0)
    watts = measured_power(t)[0]
    known = np.isfinite(watts)
    joules = np.where(known, watts, 0.0) * dt
    charging = row_states(t) == STATES.index("charging")
    metres = np.nan_to_num(t.floats("speed")) * dt
    rows = pd.DataFrame({
        "vehicle_id": t.vehicle_id, "start": stamps(t.time // QUARTER * QUARTER),
        "seconds": dt, "metres": metres, "measured_s": known * dt, "measured_m": known * metres,
        "used_kwh": np.where(charging, 0.0, joules) / KWH,
        "charged_kwh": np.where(charging, -joules, 0.0) / KWH,
    })  # fmt: skip
    return rows.groupby(KEYS, as_index=False).sum()
