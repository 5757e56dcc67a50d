"""What energy costs and emits: a price and a carbon intensity for every hour of the week.

currency = "EUR"
price = 0.24                    # per kWh
co2 = 0.38                      # kg per kWh; optional
charger_efficiency = 0.90       # battery over grid; 1 unless given
[[period]]                      # optional, any number; a later one wins
name = "night"
from = 22                       # hour of the day in the site's time zone; past midnight where to <= from
to = 6
days = ["mon", "tue"]           # days on which it begins; every day unless given
price = 0.15 co2 = 0.30"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from fleetlog.core.arrays import Floats
from fleetlog.core.schema import anything, list_of, load_toml, one_of, real, rows, table, text, whole

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
MONEY, CARBON = real(-100.0, 1e6, "per kWh"), real(0.0, 10.0, "kg per kWh")
BOTH = {"name": text, "price": MONEY, "co2": CARBON}
TOP = {**BOTH, "currency": text, "charger_efficiency": real(0.1, 1.0), "period": anything}
PERIOD = {**BOTH, "from": whole(0, 23), "to": whole(0, 24), "days": list_of(one_of(*DAYS), 1)}


@dataclass(frozen=True)
class Tariff:
    """``price`` and ``co2`` (7, 24) per kWh at the grid, by day of the week (Monday first) and hour."""

    price: Floats
    co2: Floats
    currency: str = ""
    charger_efficiency: float = 1.0
    name: str = "tariff"

    def at(self, local: pd.Series) -> tuple[Floats, Floats]:
        """Price and kg of CO2 per kWh of energy in the battery, at (N,) local times."""
        where = local.dt.day_of_week.to_numpy(), local.dt.hour.to_numpy()
        return self.price[where] / self.charger_efficiency, self.co2[where] / self.charger_efficiency


def load_tariff(path: str | Path) -> Tariff:
    """Read a tariff file; :class:`InputError` names the key at fault."""
    path = Path(path)
    top = table(load_toml(path), TOP, path, "", ("price",))
    price, co2 = np.full((7, 24), top["price"]), np.full((7, 24), top.get("co2", np.nan))
    for one in rows(top, "period", PERIOD, path, ("from", "to", "price")):
        begin, days = one["from"], np.array([DAYS.index(d) for d in one.get("days", DAYS)])
        hours = np.add.outer(24 * days, begin + np.arange((one["to"] - begin) % 24 or 24)) % price.size
        price.flat[hours.ravel()] = one["price"]
        if "co2" in one:
            co2.flat[hours.ravel()] = one["co2"]
    return Tariff(price, co2, **{k: top[k] for k in ("currency", "charger_efficiency", "name") if k in top})


def costs(used: pd.Series, charged: pd.Series, local: pd.Series, tariff: Tariff) -> tuple[Floats, Floats]:
    """(N,) cost, kg of CO2 of energy used (kWh), at the mean price of charging, else of the hour of use."""
    price, co2 = tariff.at(local)
    if (weight := charged.fillna(0.0).to_numpy(float)).sum() > 0.0:
        price, co2 = (np.full(len(used), weight @ v / weight.sum()) for v in (price, co2))
    energy = used.to_numpy(float)
    return energy * price, energy * co2
