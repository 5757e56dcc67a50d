"""The public logs as they are published are read like the tidied copies."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.proofs.public_logs import leafspy, proprioception

LOG = """Date/Time,Lat,Long,Elv,Speed,Gids,SOC,AHr,Pack Volts,Pack Amps,Ambient,epoch time,Debug
06/29/2025 21:09:36,34 11.28809,-117 25.75793,1932,68,412,869720,1072989,384.77,55.175,77.9,1751256576.729,3
06/29/2025 21:09:41,34 11.23628,-117 25.8311,1938,64,412,869711,1072989,388.30,-9.856,77.9,1751256581.865,3
"""
RUN = """time,curL,curR,velL,velR
0.0,12.41,13.2,0.2362204724409448,0.2362204724409448
0.15384615384615385,10.57,6.5,0.2362204724409448,0.2362204724409448
"""


def test_degrees_and_minutes(tmp_path: Path) -> None:
    (tmp_path / "Log.csv").write_text(LOG)
    row = leafspy(tmp_path / "Log.csv").iloc[0]
    assert (row.lat, row.lon) == pytest.approx((34.188134833, -117.429298833))
    assert (row.soc, row.volts, row.amps, row.elev_ft) == pytest.approx((86.972, 384.77, 55.175, 1932))


def test_runs_by_surface(tmp_path: Path) -> None:
    for surface, run in (("SNOW", "00"), ("ICE", "12")):
        (tmp_path / surface).mkdir()
        (tmp_path / surface / f"pro_{run}.csv").write_text(RUN)
    t = proprioception(tmp_path)
    assert set(zip(t.terrain, t.run, strict=True)) == {("SNOW", 0), ("ICE", 12)}
    assert t.curL_A.max() == pytest.approx(12.41)
