"""The page: whole, self-contained, safe with hostile names, honest about differences."""

from __future__ import annotations

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest
from click import ClickException
from click.testing import CliRunner
from drawn_trucks import T0, crossing, random_truck, rows, straight
from hypothesis import given
from hypothesis import strategies as st

import fleetlog
from fleetlog import report
from fleetlog.cli.main import cli
from fleetlog.core.site import Frame, Place, Site, Zone
from fleetlog.errors import FleetlogError
from fleetlog.report.figures import BY_NAME, FIGURES, compare, holm, truck_days

EVIL = '<script>alert("x")</script>&\'"]]>=1+1'


class Tags(HTMLParser):
    """Every tag and every attribute of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [v or "" for k, v in attrs if k in ("href", "src", "xlink:href") or k.startswith("on")]

    def handle_data(self, data: str) -> None:
        self.text += data


def fleet(write, name: str = "d", count: int = 3, first: int = 0, **site):
    trucks = [random_truck(first + k, 400) for k in range(count)]
    return write(trucks, Site(site.get("site", "plant"), Frame(50.0, 9.0, timezone="Europe/Berlin")), name)


def test_a_page_needs_nothing_from_outside(write) -> None:
    found = report(fleet(write))
    tags = Tags(found.page)
    assert not {"script", "link", "iframe", "object", "img"} & set(tags.tags) and tags.tags.count("svg") >= 2
    assert all(link.startswith(("#", "data:")) for link in tags.links)
    assert not re.search(r"url\((?!#)|@import", found.page)
    for word in ("plant", "Europe/Berlin", "2 Mar 2026 07:00", "fleetlog", "d (recorded)"):
        assert word in tags.text
    json.dumps(found.summary, default=str)


def test_names_are_only_ever_text(write) -> None:
    site = Site(EVIL, Frame(50.0, 9.0), places=(Place(EVIL, "pick", 0.0, 0.0),))
    trucks = [
        straight(v, (k * 3.0, 0), (1.5, 0), 200.0, payload=0.0) for k, v in enumerate((EVIL, "=cmd|' /C'!A0"))
    ]
    found = report(write(trucks, site))
    assert "script" not in Tags(found.page).tags
    assert "<script" not in found.page and "alert" in Tags(found.page).text


def test_ids_of_pictures_are_unique_where_they_are_referred_to(write) -> None:
    a, b = fleet(write, "a"), fleet(write, "b")
    page = report([a, b]).page
    ids = re.findall(r'<clipPath id="([^"]+)"', page)
    assert ids and len(ids) == len(set(ids))


def test_the_same_dataset_twice_differs_in_nothing(write) -> None:
    d = fleet(write, count=6)
    found = report([d, d])
    differences = found.summary["differences"]
    assert differences and all(x["p_value"] == 1.0 and x["difference"] == 0.0 for x in differences.values())
    assert "differs by more than chance" in " ".join(found.lines)


def test_figures_of_the_fleet_are_sums_over_its_trucks(write) -> None:
    found = report(fleet(write))
    ledger, figures = found.tables["ledger"], found.summary["datasets"][0]["figures"]
    by_truck = [BY_NAME["km"].of(part) for _, part in ledger.groupby("vehicle_id")]
    assert figures["km"] == pytest.approx(sum(by_truck))
    states = found.tables["states"]
    hours = (states.end - states.start)[states.state != "no_data"].dt.total_seconds().sum() / 3600
    assert figures["truck_hours"] == pytest.approx(hours)


def units(rng: np.random.Generator, n: int, level: float) -> pd.DataFrame:
    hours = rng.uniform(4, 8, n)
    return pd.DataFrame({"tasks": hours * rng.normal(level, 2.0, n), "load_hours": hours})


def test_chance_alone_is_called_significant_as_often_as_it_says() -> None:
    rng, figure = np.random.default_rng(1), BY_NAME["tasks_per_hour"]
    p = np.array([compare(units(rng, 8, 10), units(rng, 8, 10), figure).p_value for _ in range(400)])
    assert 0.01 < (p < 0.05).mean() < 0.085 and 0.4 < p.mean() < 0.6


DRAWN = {
    "near misses": lambda rng, h, n, more: rng.poisson(0.4 * more * h, n),
    "clumped near misses": lambda rng, h, n, more: rng.poisson(0.4 * more * h * rng.gamma(1.0, 1.0, n)),
    "a charge now and then": lambda rng, h, n, more: rng.poisson(0.15 * more * h, n) / 6.0,
    "a share": lambda rng, h, n, more: rng.normal(0.6 * more, 0.08, n) * h,
}


def drawn(kind: str, rng: np.random.Generator, hours: float, n: int, more: float = 1.0) -> pd.DataFrame:
    """Truck days of equal length."""
    return pd.DataFrame({"charging_h": DRAWN[kind](rng, hours, n, more), "hours": np.full(n, hours)})


@pytest.mark.parametrize("kind", DRAWN)
@pytest.mark.parametrize("hours", [(1.0, 1.0), (0.5, 1.0), (0.5, 2.0), (1.0, 8.0)])
@pytest.mark.parametrize("count", [(8, 8), (4, 30)])
def test_logs_of_unequal_length_differ_by_chance_as_often_as_any(kind: str, hours, count) -> None:
    rng, figure = np.random.default_rng(1), BY_NAME["charging_share"]
    sides = [[drawn(kind, rng, h, n) for h, n in zip(hours, count, strict=True)] for _ in range(300)]
    assert np.mean([compare(*side, figure).p_value < 0.05 for side in sides]) <= 0.085


@pytest.mark.parametrize(
    "kind, more", [("near misses", 2.5), ("a charge now and then", 4.0), ("a share", 1.15)]
)
@pytest.mark.parametrize("hours", [(1.0, 1.0), (1.0, 2.0)])
def test_a_real_difference_of_logs_of_unequal_length_is_found(kind: str, more: float, hours) -> None:
    rng, figure = np.random.default_rng(3), BY_NAME["charging_share"]
    sides = [(drawn(kind, rng, hours[0], 60), drawn(kind, rng, hours[1], 60, more)) for _ in range(100)]
    assert np.mean([compare(*side, figure).p_value < 0.01 for side in sides]) > 0.8


def test_what_some_trucks_do_not_tell_is_not_compared() -> None:
    told = pd.DataFrame({"handling_h": np.linspace(0.2, 0.3, 8), "standing_h": 0.0, "hours": 1.0})
    untold = told.assign(handling_h=0.0, standing_h=0.3)
    figure = BY_NAME["handling_share"]
    assert compare(told, told * 1.5, figure) is not None and compare(told, untold, figure) is None


def test_a_real_difference_is_found_and_its_interval_holds_it() -> None:
    rng, figure = np.random.default_rng(2), BY_NAME["tasks_per_hour"]
    found = [compare(units(rng, 20, 10), units(rng, 20, 13), figure) for _ in range(200)]
    assert np.mean([d.p_value < 0.05 for d in found]) > 0.95
    assert np.mean([d.low < 3.0 < d.high for d in found]) > 0.88
    swapped = compare(units(np.random.default_rng(3), 9, 1), units(np.random.default_rng(4), 9, 5), figure)
    back = compare(units(np.random.default_rng(4), 9, 5), units(np.random.default_rng(3), 9, 1), figure)
    assert swapped.difference == pytest.approx(-back.difference)


def test_one_truck_that_alone_does_something_is_no_difference() -> None:
    a = pd.DataFrame({"charging_h": [2.0] + [0.0] * 7, "hours": np.linspace(7.9, 8.1, 8)})
    b = pd.DataFrame({"charging_h": np.zeros(8), "hours": np.linspace(8.0, 8.2, 8)})
    assert compare(a, b, BY_NAME["charging_share"]).p_value > 0.9


def test_too_few_trucks_tell_nothing(write) -> None:
    found = report([fleet(write, "a", 2), fleet(write, "b", 2, 10)])
    assert found.summary["differences"] is None and "too few" in found.lines[0]


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_correction_for_many_figures_only_raises_p_values(p: list[float]) -> None:
    raised = holm(p)
    assert all(a <= b <= 1.0 for a, b in zip(p, raised, strict=True))
    assert min(raised) == min(min(p) * len(p), 1.0)
    assert list(np.argsort(p, kind="stable")) == sorted(range(len(p)), key=lambda i: (raised[i], p[i], i))


def test_every_figure_has_a_name_of_its_own() -> None:
    assert len(BY_NAME) == len(FIGURES)


def test_truck_days_are_days_of_the_site(write) -> None:
    """23:30 UTC is the next day in Berlin."""
    from fleetlog.report.facts import Facts, gather

    d = write([straight("A", (0, 0), (1.0, 0), 3600.0, 5.0, begin=17 * 3600.0)])
    facts = [gather(Facts("d", d, zone)) for zone in ("UTC", "Europe/Berlin")]
    assert [len(truck_days(f)) for f in facts] == [2, 1]


def test_a_log_may_end_in_the_hour_that_the_wall_has_twice(write) -> None:
    """Summer time ends on 25 October 2026 at 01:00 UTC, in Berlin at 03:00."""
    for k, hour in enumerate((0, 1)):
        day = pd.Timestamp(f"2026-10-25T{hour:02}:20:20Z")
        begin = day.value // 1000 * 1e-6 - T0 * 1e-6 - 3600.0
        truck = straight("A", (0, 0), (1.0, 0), 3600.0, 5.0, begin=begin)
        page = Tags(report(write([truck], name=f"d{k}")).page).text
        assert ("25 Oct 2026 01:20 to 02:20", "25 Oct 2026 02:20 to 02:20")[k] in page


def test_shares_of_the_first_sentence_are_those_of_utilisation_and_add_up(write) -> None:
    """One truck tells its loads, the other does not."""
    moves = np.repeat([2.0, 0.0, 2.0, 0.0], 100) * np.ones((3, 1))
    load = np.repeat([0.0, 0.0, 900.0, 900.0], 100) * np.ones((3, 1))
    own = {"x": 0.0, "y": 0.0, "heading": 0.0, "speed": moves.ravel()}
    t = np.arange(1200.0)
    short = rows("C", t, **own | {"speed": np.where(t % 100 < 60, 2.0, 0.0)})
    d = write([rows("A", t, **own, payload=load.ravel()), rows("B", t, **own), short])
    found, alone = report(d), fleetlog.analyze("utilisation", d)
    shares = [float(v) for v in re.findall(r"(\d+) %", found.lines[0])]
    assert abs(sum(shares) - 100.0) <= 0.5 * len(shares) and "does not tell which" in found.lines[0]
    figures = found.summary["datasets"][0]["figures"]
    for state in ("handling", "waiting", "standing", "idle"):
        assert figures[f"{state}_share"] == pytest.approx(100.0 * alone.summary["shares"][state])
    states = ("driving", "handling", "waiting", "standing", "charging", "idle")
    assert sum(figures[f"{state}_share"] for state in states) == pytest.approx(100.0)


def test_hours_without_rows_are_not_hours_without_tasks(write, monkeypatch) -> None:
    from fleetlog.report import sections
    from fleetlog.report.facts import Facts, gather

    drawn = []
    monkeypatch.setattr(sections, "picture", lambda f, shape, caption: drawn.append(shape))
    shifts = [
        straight("A", (0, 0), (1.0, 0), 1800.0, 5.0, begin=day * 86_400.0, payload=0.0) for day in range(3)
    ]
    sections.work(gather(Facts("d", write(shifts), "UTC")))
    known = np.isfinite(drawn[0].y["tasks"])
    assert drawn[0].counts and known.sum() == 3 and (np.diff(drawn[0].x[known]) == 86_400_000_000).all()
    assert not (known[1:] & known[:-1]).any()  # no curve from day to day


def run(*arguments: object):
    """Status and output; what the entry point would print is the error's line."""
    done = CliRunner().invoke(cli, ["report", *map(str, arguments)], standalone_mode=False)
    if done.exception is not None:
        error = done.exception
        known = isinstance(error, FleetlogError | ClickException)
        assert known, error
        return getattr(error, "exit_code", 1), error.format_message() if isinstance(
            error, ClickException
        ) else error.line()
    return done.return_value, done.stdout


def test_page_and_tables_are_written_both_or_neither(write, tmp_path: Path) -> None:
    d = fleet(write)
    page, folder, book = tmp_path / "r.html", tmp_path / "tables", tmp_path / "r.xlsx"
    status, said = run(d.path, "-o", page, "--tables", folder, "--json")
    assert status == 0 and json.loads(said)["datasets"][0]["figures"]["km"] > 0
    assert json.loads(said)["output"] == str(page)
    names = {p.stem for p in folder.glob("*.parquet")}
    assert names >= {"figures", "ledger", "states", "near_misses", "speeding"}
    assert run(d.path, "-o", tmp_path / "s.html", "--tables", folder)[0] == 1
    assert not (tmp_path / "s.html").exists()
    assert run(d.path, "-o", page, "--overwrite", "--tables", book, "-q")[0] == 0
    assert {p.name for p in tmp_path.iterdir()} >= {"r.html", "r.xlsx", "tables"}
    assert fleetlog.info(folder).summary["version"] == fleetlog.__version__


def test_a_text_that_begins_with_equals_is_no_formula(write, tmp_path: Path) -> None:
    trucks = [straight("=1+1", (0, 0), (1.5, 0), 60.0), straight("B", (9, 9), (1.5, 0), 60.0)]
    book = tmp_path / "t.xlsx"
    assert run(write(trucks).path, "-o", tmp_path / "r.html", "--tables", book)[0] == 0
    with ZipFile(book) as parts:
        sheets = [parts.read(n).decode() for n in parts.namelist() if "worksheets/sheet" in n]
        assert b"=1+1" in parts.read("xl/sharedStrings.xml")
    assert sheets and not any("<f>" in s for s in sheets)


def test_a_workbook_says_what_it_is_of_and_shows_its_times(write, tmp_path: Path) -> None:
    book = tmp_path / "t.xlsx"
    assert run(fleet(write).path, "-o", tmp_path / "r.html", "--tables", book)[0] == 0
    with ZipFile(book) as parts:
        names = re.findall(r'<sheet name="(\w+)"', parts.read("xl/workbook.xml").decode())
        texts = parts.read("xl/sharedStrings.xml").decode()
        states = parts.read(f"xl/worksheets/sheet{names.index('states') + 1}.xml").decode()
    assert {"Dataset", "Period", "Made by", "Units"} <= set(re.findall("<t>([^<]*)</t>", texts))
    widths = [float(w) for w in re.findall(r'<col [^>]*width="([\d.]+)"', states)]
    assert widths[-1] > 19 and "<autoFilter" in states  # a time of 19 letters is no row of ####


def test_energy_of_some_trucks_is_not_called_that_of_the_fleet(write) -> None:
    power = {"battery_power": 2000.0}
    alike = [straight(v, (0, 9.0 * k), (1.5, 0), 600.0, **power) for k, v in enumerate("ABC")]
    some, every = (
        write([*alike, straight("D", (0, 40), (1.5, 0), 600.0)], name="some"),
        write(alike, name="every"),
    )
    ledger = report(some).tables["ledger"].groupby("vehicle_id")["used_kwh"].sum(min_count=1)
    assert ledger[["A", "B", "C"]].gt(0.0).all() and np.isnan(ledger["D"])
    none = report(write([straight("D", (0, 0), (1.5, 0), 600.0)], name="none")).summary["datasets"][0][
        "figures"
    ]
    assert not {"kwh", "charged_kwh"} & set(none)
    assert "3 of 4 trucks (the energy of the others is unknown) used" in " ".join(report(some).lines)
    assert any(line.startswith("The fleet used") for line in report(every).lines)
    modelled = report(some, truck="counterbalance-2.5t")
    assert "kWh of it modelled, not measured" in " ".join(modelled.lines)
    figures = modelled.summary["datasets"][0]["figures"]
    assert 0.0 < figures["modelled_kwh"] < figures["kwh"] and figures["energy_known"] < 80.0
    both = [line for line in report([some, every]).lines if "energy is known" in line]
    assert len(both) == 1 and "3 of 4 in" in both[0] and "3 of 3 in" in both[0]
    assert not [line for line in report([every, every]).lines if "energy is known" in line]


@pytest.mark.parametrize(
    "arguments, status, what",
    [
        ((), 2, "Missing argument"), (("{d}", "{d}", "{d}"), 2, "one or two"), (("{d}/none",), 1, "no such dataset"),
        (("{d}", "--timezone", "Mars/Olympus"), 2, "no time zone"), (("{d}", "--truck", "nine-wheeler"), 1, "preset"),
        (("{d}", "--tariff", "{d}/none.toml"), 1, "none.toml"),
    ],
)  # fmt: skip
def test_mistakes_get_one_line_and_leave_nothing(
    write, tmp_path: Path, arguments, status: int, what: str
) -> None:
    d = write([straight("A", (0, 0), (1.0, 0), 30.0)])
    out = tmp_path / "r.html"
    found, said = run(*(a.format(d=d.path) for a in arguments), "-o", out)
    assert found == status and what in said and not out.exists()


def test_a_missing_package_names_the_extra(write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    d = write([straight("A", (0, 0), (1.0, 0), 30.0)])
    status, said = run(d.path, "-o", tmp_path / "r.html", "--tables", tmp_path / "t.xlsx")
    assert status == 1 and "fleetlog[excel]" in said
    assert not list(tmp_path.glob("[rt].*"))


@pytest.mark.parametrize("name", ["utilisation", "speeding", "near_misses"])
def test_what_the_report_adds_are_analyses_of_their_own(write, tmp_path: Path, name: str) -> None:
    import fleetlog

    trucks = crossing(1.0)
    site = Site(
        "s",
        Frame(50.0, 9.0),
        zones=(Zone("all", 99.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), 1.0),),
    )
    answer = fleetlog.analyze(name, write(trucks, site), output=tmp_path / name)
    assert (tmp_path / name / f"{name}.json").is_file() and (tmp_path / name / f"{name}.png").is_file()
    assert answer.lines and (answer.tables or answer.places)


@pytest.fixture(scope="module")
def sample(project_root: Path) -> dict:
    folder = project_root / "sample_data"
    return {"site": folder / "site.toml", "truck": folder / "truck.toml", "recording": False, "seed": 1}


def test_a_simulation_says_what_limits_it_and_a_recording_does_not(write, sample) -> None:
    simulated = fleetlog.simulate(**sample, vehicles=14, duration="10m")
    found, limits = report(simulated), simulated.summary["limits"]
    worst, said = limits["bottleneck"], Tags(found.page).text
    assert "What limits the fleet" in said and limits["one_more"]["statement"][1:] in said
    assert f"busy for {100 * worst['utilisation']:.0f} % of the time" in " ".join(found.lines)
    for r in limits["resources"]:
        assert r["kind"] in said and f"{r['queue']:.1f}" in said and (r["name"] or "–") in said
    recorded = fleet(write)
    assert "What limits the fleet</h2>" not in report(recorded).page
    both = report([recorded, simulated]).page
    section = both[both.index("What limits the fleet</h2>") :]
    assert f"<h3>{simulated.dataset.path.name}</h3>" in section[: section.index("<h2>")]


def test_a_planned_fleet_says_how_long_tasks_wait(sample, tmp_path: Path) -> None:
    tasks = tmp_path / "tasks.csv"
    tasks.write_text("from,to,earliest\n" + "dock-1,rack-1,0\n" * 6)
    simulated = fleetlog.simulate(**sample, vehicles=2, duration="10m", tasks=tasks, shadow=False)
    mean = simulated.summary["limits"]["task_wait_s"]["mean"]
    assert mean > 0.0 and f"tasks wait {mean:.0f} s for a truck" in Tags(report(simulated).page).text


def test_a_longer_stop_at_the_end_of_a_trip_is_no_driving_time(write) -> None:
    def pair(stop: float) -> pd.Series:
        rows = [straight("A", (0, 0), (1.0, 0), 60.0), straight("A", (60.0, 0), (0.0, 0), stop, begin=61.0)]
        found = report(write(rows, name=f"d{stop:.0f}")).tables["trips_between_places"]
        assert len(found) == 1
        return found.iloc[0]

    short, long = pair(30.0), pair(600.0)
    assert long.duration_mean - short.duration_mean == pytest.approx(570.0, abs=2.0)
    assert long.driving_time_mean == pytest.approx(short.driving_time_mean) == pytest.approx(60.0, abs=2.0)


@pytest.fixture(scope="module")
def experiment(sample, tmp_path_factory) -> fleetlog.Result:
    folder = tmp_path_factory.mktemp("experiment") / "vehicles & more"
    return fleetlog.simulate(
        **sample, vehicles="2..3", vary="policy=opportunity,threshold", runs=2, duration="4m", output=folder
    )


def test_the_page_of_an_experiment_needs_nothing_from_outside(experiment, tmp_path: Path) -> None:
    page = tmp_path / "e.html"
    assert run(experiment.output, "-o", page)[0] == 0
    tags = Tags(page.read_text(encoding="utf-8"))
    assert page.read_bytes() == (experiment.output / "report.html").read_bytes()
    assert fleetlog.report(experiment.output).page == experiment.page == page.read_text(encoding="utf-8")
    assert not {"script", "link", "iframe", "object", "img"} & set(tags.tags)
    assert tags.tags.count("svg") == len(experiment.shapes) >= 3
    for line in experiment.lines:  # every cell of the table in the terminal stands on the page
        assert all(cell in tags.text for cell in re.split(r"  +", line.strip()))
    assert experiment.summary["provenance"]["command"] in tags.text
    for word in ("Bottleneck", "Most tasks are done with vehicles = 3", "seed by seed", "sample plant"):
        assert word in tags.text


def test_an_experiment_stands_alone(experiment, tmp_path: Path) -> None:
    status, said = run(experiment.output, experiment.output, "-o", tmp_path / "r.html")
    assert status == 1 and "is not a dataset" in said and not (tmp_path / "r.html").exists()


def test_the_page_says_for_how_much_of_the_time_energy_is_known(write) -> None:
    def truck(name: str, known: int):
        t = np.arange(400.0)
        load = np.where((t // 40).astype(int) % 2 == 0, 0.0, 900.0)
        out = rows(name, t, x=0.0, y=0.0, heading=0.0, speed=np.where(t % 40 < 20, 0.0, 2.0), payload=load)
        return out.with_columns(battery_power=np.where(t < known, 2000.0, np.nan))

    whole, half = (report(write([truck("T", k)], name=f"d{k}")) for k in (400, 200))
    figures = [r.summary["datasets"][0]["figures"] for r in (whole, half)]
    assert figures[1]["energy_known"] == pytest.approx(50.0, abs=0.5)
    assert figures[1]["kwh_per_task"] == pytest.approx(figures[0]["kwh_per_task"], rel=0.3)
    assert not any("for which energy is known" in line for line in whole.lines)
    assert any("in the 50.1 % of the time for which energy is known" in line for line in half.lines)
    assert "Time with known energy" in Tags(half.page).text
