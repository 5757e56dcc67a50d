"""The queries of docs/scale.md give what the dataset holds."""

import re

import pytest


def blocks(project_root, language):
    text = (project_root / "docs" / "scale.md").read_text()
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def energy_kwh(fleet):
    return fleet.trips.energy.sum() / 3.6e6


def test_duckdb(project_root, fleet, monkeypatch):
    duckdb = pytest.importorskip("duckdb", reason="duckdb is not installed")
    monkeypatch.chdir(fleet.path.parent)
    (fleet.path.parent / "plant").exists() or (fleet.path.parent / "plant").symlink_to(fleet.path)
    daily, near = blocks(project_root, "sql")[:2]
    table = duckdb.sql(daily).df()
    assert len(table) == len(fleet.vehicle_days) and table.hours.sum() == pytest.approx(
        fleet.rows / 3600.0, rel=1e-6
    )
    assert table.kwh.sum() == pytest.approx(energy_kwh(fleet), rel=0.01)
    connection = duckdb.connect()
    try:
        connection.execute("INSTALL spatial; LOAD spatial")
    except duckdb.Error:
        pytest.skip("the spatial extension of DuckDB cannot be loaded here")
    assert connection.sql(near).df().rows.sum() <= fleet.rows


def test_polars(project_root, fleet, monkeypatch):
    pl = pytest.importorskip("polars", reason="polars is not installed")
    monkeypatch.chdir(fleet.path.parent)
    (fleet.path.parent / "plant").exists() or (fleet.path.parent / "plant").symlink_to(fleet.path)
    code = next(b for b in blocks(project_root, "python") if "polars" in b)
    names: dict = {}
    exec(code, names)
    assert isinstance(names["daily"], pl.DataFrame) and len(names["daily"]) == len(fleet.vehicle_days)
    assert names["daily"]["kwh"].sum() == pytest.approx(energy_kwh(fleet), rel=0.01)
