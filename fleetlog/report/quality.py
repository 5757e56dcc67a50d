"""How good the data of every truck are."""

from typing import Any

import numpy as np
import pandas as pd

from fleetlog.core.words import count
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP

CHANNELS = {
    "speed": "speed", "payload": "load", "fork_height": "forks", "battery_power": "power",
    "soc": "state of charge", "ambient_temperature": "temperature",
}  # fmt: skip


def quality(dataset: Dataset) -> tuple[pd.DataFrame, list[str]]:
    """One row a truck: rows, usual interval [s], shares of time without data and on a road, channels."""
    trucks: dict[str, list[dict[str, Any]]] = {}
    for t in dataset.days((*CHANNELS, "edge_id")):
        step = np.diff(t.time) * 1e-6
        trucks.setdefault(t.vehicle_id, []).append({
            "rows": len(t), "steps": step, "road": int((t.labels("edge_id").codes >= 0).sum()),
            "channels": {c for c in CHANNELS if t.has(c)},
        })  # fmt: skip
    rows = [{"vehicle_id": name, **_row(days)} for name, days in trucks.items()]
    return pd.DataFrame(rows), _lines(dataset)


def _row(days: list[dict[str, Any]]) -> dict[str, Any]:
    rows, steps = sum(d["rows"] for d in days), np.concatenate([d["steps"] for d in days])
    has = set.union(*(d["channels"] for d in days))
    return {
        "rows": rows, "interval_s": float(np.median(steps)) if len(steps) else np.nan,
        "silent": float(steps[steps > MAX_GAP].sum() / max(steps.sum(), 1e-9)),
        "on_road": sum(d["road"] for d in days) / max(rows, 1),
        "channels": ", ".join(word for c, word in CHANNELS.items() if c in has) or "position only",
    }  # fmt: skip


def _lines(dataset: Dataset) -> list[str]:
    """What the import rejected and derived."""
    s = dataset.meta.get("summary") or {}
    if dataset.kind == "simulated":
        return ["The data are simulated: nothing is missing and nothing was rejected."]
    out = [f"{count(dataset.rows, 'row')} of {count(len(s.get('files') or []), 'file')}."]
    for key, what in (("rejected", "row"), ("rejected_values", "value")):
        reasons = s.get(key) or {}
        if reasons:
            why = "; ".join(f"{n:,} {reason}" for reason, n in sorted(reasons.items(), key=lambda i: -i[1]))
            out.append(f"{count(sum(reasons.values()), what)} rejected: {why}.")
    if s.get("matched") is not None:
        out.append(f"{100.0 * float(s['matched']):.1f} % of the rows are on a road.")
    return out
