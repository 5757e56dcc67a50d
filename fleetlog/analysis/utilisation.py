"""What the trucks do: drive empty or laden, handle loads, wait, charge, stand idle.

A simulation says so itself.  Of a recording it is read from motion, load, forks and power, by these rules:

- it moves where its speed exceeds :data:`~fleetlog.store.trips.STANDING_SPEED`; laden from 25 kg on;
- a standstill in which the battery takes power, or the log says so, is charging; where the state of charge
  rises by more than ``MIN_CHARGE``, the time from its lowest until it falls again is;
- within ``REACH`` of a change of load, or of a movement of the forks, a truck that stands is handling;
- any other standstill is waiting with a load on the forks, or, of at most ``PATIENCE``, before a truck takes
  a load up or on its way; else idle: after a load was set down, until the truck sets off again (without its
  orders, one that waits there for its next task to begin cannot be told from an idle one);
- a silence of the log longer than ``MAX_GAP`` is no data, unless the charge rises before and after it: where
  it rises only meanwhile, the battery was charged, but not all the time.

The intervals of a truck partition the time from its first to its last row."""

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.result import Bars, Result
from fleetlog.core.trajectory import Labels, Trajectory, concatenate
from fleetlog.core.words import listed, percent
from fleetlog.errors import DataError
from fleetlog.physics.motion.channels import measured_power
from fleetlog.simulate.places import MIN_CHARGE
from fleetlog.store import Dataset
from fleetlog.store.events import read_table
from fleetlog.store.trips import MAX_GAP, MIN_LOAD_CHANGE, STANDING_SPEED

STATES, UNTOLD, OF_ACTIVITY = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).values()
REACH, REACH_WITHOUT_FORKS = 10.0, 30.0
"""Handling lasts this long before and after a movement of the forks or a change of the load at most [s]."""
FORKS = 0.05  # The forks move when their height changes by more than this in a second [m]
PATIENCE, PATIENCE_WITHOUT_LOAD = 180.0, 60.0
"""A truck that stands without a load for longer is idle, also where the log has no loads [s]."""
CHARGER, SHORTEST_CHARGE = 100.0, 20.0
"""A battery that takes more than this on average [W] over a standstill of this length [s] is charged; what
flows back while a truck brakes may be logged when it stands already."""
COLUMNS = ("speed", "payload", "fork_height", "battery_power", "soc", "charging")
QUARTER = 900_000_000  # Intervals are cut at quarters of an hour [us], at which hours of any time zone begin
MOST_QUARTERS = 4_000_000  # Of all vehicles together: a hundred vehicles for a year


def utilisation(dataset: Dataset) -> Result:
    """Divide the time of every truck by what it does.

    The result has table ``states``: vehicle_id, state, charged, start, end; table ``utilisation``: hours by
    truck and state; summary with the hours and shares of the fleet."""
    table = states(dataset)
    hours = hours_by_state(table, table["vehicle_id"])
    total = hours.sum()
    known = float(total.drop("no_data").sum())
    shares = {s: float(total[s] / known) if known else None for s in STATES if s != "no_data"}
    summary = {"hours": {s: float(total[s]) for s in STATES}, "shares": shares}
    said = listed([f"{s} {percent(v)}{UNTOLD.get(s, '')}" for s, v in shares.items() if v and v >= 0.005])
    nothing = "No truck has two rows: there is no time to divide."
    lines = [f"{known:.1f} truck hours: {said.replace('_', ' ')}." if known else nothing]
    if len(hours) > 1 and total["idle"]:
        idle = hours["idle"] / hours.drop(columns="no_data").sum(axis=1).clip(lower=1e-9)
        if (most := percent(idle.max())) != percent(0.0):
            lines.append(f"{idle.idxmax()} is idle most: {most} of its time.")
    tables = {"states": table, "utilisation": hours.reset_index(names="vehicle_id")}
    return Result("utilisation", summary, tables, {}, [state_bars("utilisation", hours)], lines)


def hours_by_state(table: pd.DataFrame, *by: pd.Series) -> pd.DataFrame:
    """Hours in every state, one row for each combination of ``by`` (aligned with the rows of ``table``)."""
    hours = (table["end"] - table["start"]).dt.total_seconds() / 3600.0
    sums = hours.groupby([*by, table["state"]]).sum().unstack(fill_value=0)
    return sums.reindex(columns=STATES, fill_value=0.0)


def state_bars(name: str, hours: pd.DataFrame) -> Bars:
    """Shares of the time by state, one bar a row of :func:`hours_by_state`; time without data is left out."""
    known = hours.drop(columns="no_data")
    share = 100.0 * known.div(known.sum(axis=1).clip(lower=1e-9), axis=0)
    parts = {str(s): share[s].to_numpy(float) for s in known if (known[s] > 0.0).any()}
    labels = tuple(str(v) for v in share.index)
    return Bars(name, labels, share.sum(axis=1).to_numpy(float), "share of the time [%]", parts)


def states(dataset: Dataset) -> pd.DataFrame:
    """Intervals that partition each vehicle's time: vehicle_id, state, ``charged`` or not, start, end."""
    if (activities := read_table(dataset, "activities")) is not None:
        named = activities.assign(state=activities["activity"].map(OF_ACTIVITY))
        named = named[named["end"] > named["start"]]
        named = named.assign(charged=named["state"] == "charging").reset_index(drop=True)
        return named[["vehicle_id", "state", "charged", "start", "end"]]
    if not (found := [intervals(t) for t in joined_days(dataset, COLUMNS)]):
        raise DataError("the dataset has no rows", where=dataset.path)
    return pd.concat(found, ignore_index=True)


def joined_days(dataset: Dataset, columns: Sequence[str]) -> Iterator[Trajectory]:
    """The days of every vehicle, each with the last row of the day before: nothing is lost at midnight."""
    last: Trajectory | None = None
    for day in dataset.days(columns):
        yield concatenate([last, day]) if last is not None and last.vehicle_id == day.vehicle_id else day
        last = day[-1:]


def intervals(t: Trajectory) -> pd.DataFrame:
    """The states of one truck, from its rows: each lasts from a row to the next."""
    code, charged = (rows[:-1] for rows in row_states(t))
    first = np.flatnonzero(np.diff(2 * code + charged, prepend=-1))
    ends = np.append(t.time[first[1:]], t.time[-1:] if len(first) else t.time[:0])
    named, starts = np.array(STATES, dtype=object)[code[first]], stamps(t.time[first])
    frame = {"vehicle_id": t.vehicle_id, "state": named, "charged": charged[first]}
    return pd.DataFrame({**frame, "start": starts, "end": stamps(ends)})


def stamps(time: Ints) -> pd.DatetimeIndex:
    """Times [us] as a table holds them."""
    return pd.to_datetime(time, unit="us", utc=True).as_unit("us")


def row_states(t: Trajectory) -> tuple[Ints, Mask]:
    """(N,) index into ``STATES`` of the time from each row to the next, and whether the truck is charged."""
    number = {s: i for i, s in enumerate(STATES)}
    still = np.nan_to_num(t.floats("speed")) <= STANDING_SPEED
    load = t.floats("payload")
    laden = np.nan_to_num(load) > MIN_LOAD_CHANGE
    step, silent = np.diff(t.time, append=t.time[-1:]), silences(t)
    stand = np.cumsum(np.diff(still | silent, prepend=False) | np.diff(silent, prepend=False), dtype=np.int64)
    first = np.flatnonzero(np.diff(stand, prepend=-1))
    rows = np.diff(np.append(first, len(stand)))
    lasts = np.repeat(np.add.reduceat(step * 1e-6, first), rows)
    loads, forks = t.has("payload"), t.has("fork_height")
    out = np.where(laden, number["driving_laden"], number["driving_empty" if loads else "driving"])
    # After the load was set down in the same standstill, a truck does not wait.
    down = pd.Series(np.diff(laden.astype(np.int8), prepend=0) < 0).groupby(stand).cummax().to_numpy(bool)
    waits = laden | ((lasts <= (PATIENCE if loads else PATIENCE_WITHOUT_LOAD)) & ~down)
    out[still] = np.where(waits[still], number["waiting" if loads or forks else "standing"], number["idle"])
    out[still & _handling(t, still, load)] = number["handling"]
    # Where the log says so, and standstills in which the battery takes power on average.
    text = isinstance(t.columns.get("charging"), Labels)
    charged = np.zeros(len(t), bool) if text else t.floats("charging") > 0.0
    taken = np.repeat(-np.add.reduceat(np.nan_to_num(t.floats("battery_power")), first) / rows, rows)
    out[still & (charged | (taken > CHARGER) & (lasts >= SHORTEST_CHARGE))] = number["charging"]
    out[silent] = number["no_data"]
    rises, sure = _rising(t, still, silent)
    out[rises & (sure | ~silent)] = number["charging"]
    return np.asarray(out, dtype=np.int64), (out == number["charging"]) | rises


def charging(t: Trajectory) -> Mask:
    """(N,) whether the battery is charged from each row to the next, and gives nothing meanwhile."""
    power, soc = measured_power(t), soc_level(t)
    falls = np.diff(soc, append=soc[-1:]) < 0.0
    gives = np.where(np.isfinite(power) & ~silences(t), power > 0.0, falls)
    return row_states(t)[1] & ~gives


def _rising(t: Trajectory, still: Mask, silent: Mask) -> Mask:
    """(2, N) standstills in which the state of charge rises, from its lowest until it falls again, and the
    part in which it rose before and rises after.  A silence belongs to the standstill that it begins in, and
    is one of its own where the truck still drove."""
    kind, soc, out = np.where(still, 0, np.where(silent, 1, 2)), soc_level(t), np.zeros((2, len(t)), bool)
    first = np.flatnonzero(np.diff(kind, prepend=-1))
    last = np.append(first[1:], len(t) - 1)  # The row that ends the time of the one before it
    charged = (kind[first] < 2) & (soc[last] - soc[first] > MIN_CHARGE)
    for begin, end in zip(first[charged].tolist(), last[charged].tolist(), strict=True):
        low = end - 1 - int(np.argmin(soc[begin:end][::-1]))
        after = soc[low : end + 1]
        out[0, low : end - np.argmax(after[::-1])] = True
        out[1, low + 1 : low + int(np.argmax(after)) - 1] = True
    return out


def soc_level(t: Trajectory) -> Floats:
    """(N,) state of charge, held between its values; what changes over a silence changes in no other row."""
    stretch, soc = np.cumsum(np.append(False, silences(t)))[:-1], pd.Series(t.floats("soc"))
    return np.asarray(soc.groupby(stretch).ffill().groupby(stretch).bfill().ffill(), dtype=np.float64)


def silences(t: Trajectory) -> Mask:
    """(N,) whether the log is silent from each row to the next."""
    return np.asarray(np.diff(t.time, append=t.time[-1:]) > MAX_GAP * 1e6)


def _handling(t: Trajectory, still: Mask, load: Floats) -> Mask:
    """Rows near a change of the load or the forks at a standstill."""
    # Against the last row that is a second old: from one to the next of ten a second hardly anything changes.
    before = np.maximum(np.searchsorted(t.time, t.time - 1_000_000, side="right") - 1, 0)
    changes = np.abs(load - load[before]) > MIN_LOAD_CHANGE
    height = t.floats("fork_height")
    changes |= np.abs(height - height[before]) > FORKS
    # A change shows in the first row after it: that of a truck that has set off again counts, too.
    if not len(at := t.time[changes & (still | np.roll(still, 1))]):
        return np.zeros(len(t), dtype=bool)
    after = np.searchsorted(at, t.time)
    near = [np.abs(t.time - at[np.clip(after + k, 0, len(at) - 1)]) for k in (-1, 0)]
    return np.asarray(np.minimum(*near) <= (REACH if t.has("fork_height") else REACH_WITHOUT_FORKS) * 1e6)


def quarters(table: pd.DataFrame) -> pd.DataFrame:
    """The intervals cut at quarters of an hour, so that each lies in one hour of any time zone."""
    start, end = (table[c].astype("datetime64[us, UTC]").astype("int64").to_numpy() for c in ("start", "end"))
    count = np.maximum((end - 1) // QUARTER - start // QUARTER, 0) + 1
    if count.sum() > MOST_QUARTERS:
        years = count.sum() * QUARTER / 31_557_600e6
        what = f"{years:,.0f} years of vehicles are too many for quarters of an hour"
        raise DataError(what, do="import it without rows of a wrong time")
    row = np.repeat(np.arange(len(table)), count)
    step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    low = np.maximum(start[row], (start[row] // QUARTER + step) * QUARTER)
    high = np.minimum(end[row], (start[row] // QUARTER + step + 1) * QUARTER)
    return table.iloc[row].reset_index(drop=True).assign(start=stamps(low), end=stamps(high))
