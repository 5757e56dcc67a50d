"""Places where trucks stop regularly, and what for."""

from typing import Annotated

import pandas as pd

from fleetlog.core.arguments import Between
from fleetlog.core.result import Marks, Result, Shape
from fleetlog.core.site import PlaceKind
from fleetlog.core.words import Sentences, listed
from fleetlog.simulate.demand import carried
from fleetlog.simulate.places import Stands, clusters, find_stands, mined_site, place_table
from fleetlog.store import Dataset
from fleetlog.store.days import each_day

SAID = Sentences(__file__)
KINDS: tuple[PlaceKind, ...] = ("pick", "drop", "park", "charge")
TOML = '[[place]]\nid = "{0.id}"\nkind = "{0.kind}"\nx = {0.x:.2f}\ny = {0.y:.2f}'  # Of a site file


def stops(dataset: Dataset, *, min_visits: Annotated[int, Between(1, 10**9, whole=True)] = 3) -> Result:
    """Find the places where trucks stop regularly, and what for.

    The result has table ``places`` (place, kind, x, y, spread, visits, vehicles, dwell, shares of picks,
    drops and charges), under the names of the site where it knows them; table ``flows`` with the loads
    carried from place to place; summary with counts and, as ``[[place]]`` text, the places that the site file
    lacks.

    Parameters
    ----------
    min_visits : minimum number of visits that makes a place."""
    stands = find_stands(dataset)
    cluster = clusters(stands, min_visits)
    table = place_table(stands, cluster)
    site, names = mined_site(dataset.site, table)
    table["place"] = names
    tasks = carried(stands, cluster, names)
    loads = pd.DataFrame([(t.source, t.target, t.payload) for t in tasks], columns=["from", "to", "payload"])
    of = loads.groupby(["from", "to"], as_index=False)
    flows = of.agg(loads=("payload", "size"), payload_mean=("payload", "mean"))
    weighed = any(list(each_day(dataset, _weighed, kinds=(Stands,), cost=0.05e-6)))
    kinds = {k: int((table.kind == k).sum()) for k in KINDS}
    summary = {
        "stops": len(stands), "in_places": int((cluster >= 0).sum()), "places": len(table), "kinds": kinds,
        "standing_s": float(stands.dwell.sum()), "loads_carried": len(tasks) if weighed else None,
        "site_toml": "\n".join(map(TOML.format, site.places[len(dataset.site.places) :])),
    }  # fmt: skip
    told = f": {listed([f'{n} {k}' for k, n in kinds.items() if n])}" if len(table) else ""
    loads_told = SAID("loads", loads=len(tasks), pairs=len(flows)) if weighed else SAID("no_loads")
    busiest = table.sort_values("dwell_total", ascending=False, kind="stable").head(5)
    lines = [SAID("stops", **summary, told=told), loads_told]
    lines += [SAID("place", place=place) for place in busiest.itertuples()]
    # The larger the longer trucks stand there.
    ring = 3.0 * (table.dwell_total / max(table.dwell_total.max() or 0.0, 1.0)) ** 0.5
    drawn = ((f"trucks {k} here (larger: longer)", table[table.kind == k], k) for k in KINDS)
    marks: list[Shape] = [
        Marks(name, t[["x", "y"]].to_numpy(float), tuple(t.place), ring[t.index].to_numpy(), kind)
        for name, t, kind in drawn
        if len(t)
    ]
    return Result("stops", summary, {"flows": flows}, {"places": table}, marks, lines)


def _weighed(dataset: Dataset, vehicle: str, date: str) -> bool:
    """Whether a vehicle-day knows its loads."""
    return dataset.read(vehicle, date, ("payload",)).has("payload")
