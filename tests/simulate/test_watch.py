"""Rings of trucks that wait for one another are found; standing on purpose is no waiting."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.simulate.state import Mode, new_fleet
from fleetlog.simulate.watch import Watch, rings


@given(st.dictionaries(st.integers(0, 30), st.integers(-1, 35), max_size=31))
def test_rings_are_all_cycles_each_once(blocker):
    found = rings(blocker)
    # Another way to the same: who comes back to itself is on a cycle.
    on_cycle = set()
    for start in blocker:
        v = start
        for _ in range(len(blocker)):
            v = blocker.get(v, -2)
            if v == start:
                on_cycle.add(start)
                break
    assert sorted(v for ring in found for v in ring) == sorted(on_cycle)
    for ring in found:
        assert all(blocker[a] == b for a, b in zip(ring, [*ring[1:], ring[0]], strict=True))


def test_only_who_wants_to_move_and_does_not_is_still():
    fleet = new_fleet(3, 1, 1, 1, 4)
    fleet.mode[:] = (Mode.DRIVING, Mode.DRIVING, Mode.PARKED)
    watch = Watch(None, fleet)
    for now in range(0, 100, 10):
        fleet.moved[0] += 1.0
        still = watch.still(float(now))
    assert still.tolist() == [0.0, 90.0, 0.0]
    assert watch.longest == 90.0
    fleet.moved[:2] += 1.0
    assert not np.any(watch.still(100.0))
