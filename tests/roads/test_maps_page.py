"""What docs/maps.md shows, done."""

import re

import pytest

from fleetlog.roads import load_site
from fleetlog.roads.load import readers


@pytest.fixture
def page(project_root, tmp_path):
    text = (project_root / "docs" / "maps.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"```(json|toml|python)\n(.*?)```", text, re.DOTALL))
    (tmp_path / "roads.geojson").write_text(blocks["json"])
    (tmp_path / "site.toml").write_text(blocks["toml"])
    return text, blocks, tmp_path


def test_the_small_site_is_as_drawn(page):
    _, _, folder = page
    site, (report,) = load_site(folder)
    network = site.roads()
    follow = {e: {network.edge_ids[j] for j in network.successors(i)} for i, e in enumerate(network.edge_ids)}
    assert follow == {"a": {"b"}, "-a": {"a"}, "b": {"-b"}, "-b": {"-a"}, "c": {"-a", "b"}}
    assert report.notes == () and len(site.places) == len(site.zones) == len(site.buildings) == 1


def test_the_python_example_runs(page, monkeypatch, capsys):
    _, blocks, folder = page
    monkeypatch.chdir(folder)
    exec(blocks["python"], {})
    assert "GeoJSON: 3 roads read, 3 kept" in capsys.readouterr().out


def test_every_format_is_on_the_page(page):
    text, _, _ = page
    table = text[: text.index("## A small site")]
    for reader in readers().values():
        assert all(f"`{suffix}`" in table for suffix in reader.suffixes)
