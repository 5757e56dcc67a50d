"""Bad input: one clear line each."""

import numpy as np
import pytest
from simulated_sites import TRUCK, grid, place, road

from fleetlog.core.network import build_network
from fleetlog.core.site import Site
from fleetlog.errors import DataError, InputError, SiteError
from fleetlog.simulate.tasks import Demand, Task, read_tasks


def one_line(error):
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_place_off_the_roads(simulated):
    with pytest.raises(SiteError) as error:
        simulated(grid(places=[place(1, "pick", -80, -80)]), 1, 10.0)
    assert "pick1" in one_line(error)
    assert "off the roads" in str(error.value)


def test_an_unreachable_place(simulated):
    edges = road("a", "p", "q", np.array([[0.0, 0.0], [60.0, 0.0]]))
    edges += road("b", "r", "s", np.array([[0.0, 50.0], [60.0, 50.0]]))
    site = Site(
        "islands", network=build_network(edges), places=(place(1, "pick", 30, -3), place(1, "drop", 30, 47))
    )
    with pytest.raises(SiteError) as error:
        simulated(site, 1, 10.0, demand=Demand([Task(None, "pick1", "drop1", 100.0, 0.0)], endless=False))
    assert "cannot be reached" in one_line(error)


def test_a_place_without_room_beside_the_road_is_served_on_it(simulated):
    """So many places at one spot that no bay is left for the last ones."""
    edges = road("a", "p", "q", np.array([[0.0, 0.0], [60.0, 0.0]]))
    places = (place(1, "drop", 50, 3), *(place(n, "pick", 15.0, 1.0) for n in range(1, 40)))
    site = Site("road", network=build_network(edges), places=places)
    task = Task(None, "pick39", "drop1", 100.0, 0.0)
    summary = simulated(site, 1, 400.0, demand=Demand([task], endless=False)).summary
    assert any("no room beside the road at" in n and "'pick39'" in n for n in summary.notes)
    assert summary.count.tasks_done == 1


@pytest.mark.parametrize("count", [0, -3])
def test_no_vehicles(simulated, count):
    with pytest.raises(DataError) as error:
        simulated(grid(), count, 10.0)
    assert "vehicles" in one_line(error)


def test_more_trucks_than_the_site_can_hold(simulated):
    with pytest.raises(SiteError) as error:
        simulated(grid(2, 2), 500, 10.0)
    assert "more than the site can hold" in one_line(error)


@pytest.mark.parametrize(
    "row, told",
    [
        (",pick1,pick1,900,0", "both 'pick1'"),
        (",pick1,nowhere,100,0", "no place 'nowhere'"),
        (",pick1,drop1,heavy,0", "not a number"),
        (",pick1,drop1,-5,0", "must be at least 0"),
        (",pick1", "no place ''"),
        (",pick1,drop1,5,0,7", "more fields"),
        (f",pick1,drop1,{'9' * 400},0", "not a finite number"),
        (f",pick1,{'x' * 200_000},5,0", "larger than field limit"),
    ],
)
def test_tasks_that_cannot_be(tmp_path, row, told):
    file = tmp_path / "tasks.csv"
    file.write_text(f"vehicle,from,to,payload,earliest\n{row}\n")
    site = grid(places=[place(1, "pick", 15, 3), place(1, "drop", 45, 33)])
    with pytest.raises(InputError) as error:
        read_tasks(file, site, TRUCK)
    assert told in one_line(error)
    assert "line 2" in str(error.value) or "CSV" in str(error.value)


@pytest.mark.parametrize(
    "data, told",
    [
        (b"", "no column 'from'"),
        (b"from,to,earlyest\n", "did you mean 'earliest'"),
        (b"from,to,to\n", "more than once"),
        (b"from;to\n", "unknown column 'from;to'"),
        (b"from,to\n\xff\xfe,x\n", "not readable"),
    ],
)
def test_files_that_hold_no_tasks(tmp_path, data, told):
    file = tmp_path / "tasks.csv"
    file.write_bytes(data)
    with pytest.raises(InputError) as error:
        read_tasks(file, grid(places=[place(1, "pick", 15, 3)]), TRUCK)
    assert told in one_line(error)


def test_exported_tasks_are_the_same_tasks(tmp_path):
    site = grid(places=[place(1, "pick", 15, 3), place(1, "drop", 45, 33)])
    plain, exported = tmp_path / "tasks.csv", tmp_path / "exported.csv"
    plain.write_text("vehicle,from,to,payload,earliest\nT1,pick1,drop1,800,90\n,pick1,drop1,700,0.5\n")
    exported.write_text(
        "task,vehicle_id,from_place,to_place,payload,earliest,status\n"
        "0,T1,pick1,drop1,800,2026-01-05T06:01:30.000000Z,done\n"
        "1,,pick1,drop1,700,2026-01-05 06:00:00.500000+00:00,waiting\n"
        "2,T1,pick1,,700,2026-01-05T06:02:00Z,assigned\n"
    )
    start = 1_767_592_800_000_000
    found, same = read_tasks(exported, site, TRUCK, 3, start), read_tasks(plain, site, TRUCK, 3)
    assert found.given == same.given and not same.notes
    assert found.notes == ["1 task left out: no place to go to was chosen yet"]
    with pytest.raises(InputError, match="line 3"):
        read_tasks(exported, site, TRUCK, 3, start + 1_000_000)


def test_a_line_break_in_a_cell_does_not_shift_the_lines(tmp_path):
    file = tmp_path / "tasks.csv"
    file.write_text('from,to,payload,note\npick1,drop1,5,"a\nb"\n\npick1,drop1,-5,\n')
    site = grid(places=[place(1, "pick", 15, 3), place(1, "drop", 45, 33)])
    with pytest.raises(InputError, match="line 5"):
        read_tasks(file, site, TRUCK)


def test_rows_that_do_not_fall_on_steps(simulated):
    with pytest.raises(DataError):
        simulated(grid(), 1, 10.0, interval=0.25)
