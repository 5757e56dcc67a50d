"""Time between rows too far apart is left out by all analyses alike, and said to be so."""

import numpy as np
import pytest

from fleetlog.analysis.apart import LONGEST, left_out, remark
from fleetlog.analysis.density import density
from fleetlog.analysis.heatmap import heatmap
from fleetlog.analysis.near_misses import near_misses
from fleetlog.analysis.speeding import speeding
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset, DatasetWriter

from .conftest import T0, grid_site, walk


def recorded(path, *times):
    """A fleet in which truck k has rows at the seconds ``times[k]``."""
    site = grid_site()
    with DatasetWriter.create(path, "recorded", site) as w:
        for k, seconds in enumerate(times):
            t = walk(site.roads(), k, len(seconds))
            w.write(Trajectory(t.vehicle_id, T0 + (np.asarray(seconds) * 1e6).astype(np.int64), t.columns))
    return Dataset(path)


@pytest.mark.parametrize("answer", [density, heatmap, near_misses, speeding])
@pytest.mark.parametrize("every, known", [(1.0, True), (90.0, False)])
def test_what_rows_cannot_tell_is_unknown_and_not_zero(tmp_path, answer, every, known):
    result = answer(recorded(tmp_path / "d", *2 * [np.arange(200) * every]))
    figure = {"density": "delay_s", "heatmap": "vehicle_hours", "speeding": "over_s"}.get(
        result.name, result.name
    )
    assert (result.summary[figure] is not None) == known == (result.summary["left_out_share"] == 0.0)
    assert ("unknown" in result.lines[0]) != known and (known or len(result.lines) == 1)


def test_the_share_is_that_of_the_time(tmp_path):
    dense, sparse = np.arange(0.0, 301.0), np.arange(0.0, 301.0, 20.0)
    d = recorded(tmp_path / "d", dense, sparse)
    assert left_out(d) == pytest.approx(0.5) and left_out(d, 20.0) == 0.0
    assert left_out(d, vehicles=["T1"]) == 1.0
    assert any("50 %" in line for line in density(d).lines) and any(
        "50 %" in line for line in heatmap(d).lines
    )
    assert density(d).summary["delay_s"] is not None


@pytest.mark.parametrize("silence", [70.0, 3600.0])
def test_silences_between_shifts_are_no_rows_too_far_apart(tmp_path, silence):
    shift = np.arange(0.0, 120.0)
    one = np.concatenate([k * (120.0 + silence) + shift for k in range(3)])
    assert left_out(recorded(tmp_path / "d", one)) == 0.0
    slow = np.concatenate([k * (1200.0 + silence) + 10 * shift for k in range(3)])
    assert left_out(recorded(tmp_path / "e", slow), 5.0) == 1.0


def test_a_share_that_does_not_show_is_not_told():
    assert remark("X", 0.004) == [] and len(remark("X", 0.006)) == 1
    assert remark("X", 1.0) == [f"X: unknown, as all rows are more than {LONGEST:g} s apart."]
