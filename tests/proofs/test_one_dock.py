"""Where one dock gets all the work, the density analysis names its roads first."""

import pytest

from fleetlog.analysis.density import density
from tests.proofs.one_dock import DOCKS, dock_roads, run


@pytest.mark.slow
@pytest.mark.parametrize("dock", DOCKS)
def test_the_dock_is_area_one(dock, tmp_path):
    data, site = run(dock, tmp_path / "one")
    result = density(data)
    first, *others = result.summary["areas"]
    roads = set(first["roads"].split(", "))
    assert dock_roads(site, dock) <= roads
    assert first["delay"] > 0.5 * result.summary["delay_s"] and all(
        first["delay"] > 3 * a["delay"] for a in others
    )
    spread, _ = run(dock, tmp_path / "spread", spread=True)
    there = density(spread)
    shares = [
        r["delay"] / there.summary["delay_s"]
        for r in there.summary["areas"]
        if dock_roads(site, dock) & set(r["roads"].split(", "))
    ]
    assert max(shares, default=0.0) < first["delay"] / result.summary["delay_s"]
