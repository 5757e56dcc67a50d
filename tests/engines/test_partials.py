"""Partial results beside a dataset: found again, never trusted blindly, bounded, and plain data only."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as some

from fleetlog.analysis.density import density
from fleetlog.analysis.energy import energy
from fleetlog.store import Dataset
from fleetlog.store import days as partials
from fleetlog.store.days import encode, pack, unpack
from fleetlog.store.output import share


@dataclass(frozen=True)
class Thing:
    name: str
    values: np.ndarray


@dataclass(frozen=True)
class Other:
    name: str
    values: np.ndarray


arrays = some.arrays(
    st.sampled_from([np.float64, np.int64, np.int32, np.bool_]),
    some.array_shapes(min_dims=0, max_dims=3, min_side=0),
)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | arrays
    | st.builds(Thing, st.text(), arrays),
    lambda inner: st.lists(inner) | st.tuples(inner, inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)  # fmt: skip


@given(plain)
def test_what_is_packed_comes_back(value):
    assert encode(unpack(pack(value), [Thing])) == encode(value)


@given(plain, st.data())
def test_damage_is_seen(value, data):
    packed = bytearray(pack(value))
    at = data.draw(st.integers(0, len(packed) - 1))
    packed[at] ^= 1 << data.draw(st.integers(0, 7))
    with suppress(ValueError):  # a flip of the bits that fill the last byte changes nothing
        assert encode(unpack(bytes(packed), [Thing])) == encode(value)


def test_sets_have_one_encoding():
    words = [f"word-{k}" for k in range(50)]
    assert encode(frozenset(words)) == encode(frozenset(reversed(words)))


def test_nothing_but_plain_data():
    with pytest.raises(TypeError, match="plain data"):
        pack(np.array([object()]))
    with pytest.raises(TypeError, match="plain data"):
        pack(print)
    with pytest.raises(ValueError, match="plain data"):
        unpack(pack(Thing("a", np.zeros(2))), [Other])


@pytest.fixture
def dataset(fleet, tmp_path, monkeypatch):
    """A copy of the fleet whose results are kept."""
    monkeypatch.setattr(partials, "FROM_ROWS", 0)
    share(fleet.path, tmp_path / "d")
    return Dataset(tmp_path / "d")


def kept(dataset):
    return sorted(p for p in (dataset.path / ".partials").rglob("*") if p.is_file())


def no_reading(*_args, **_options):
    raise AssertionError("rows were read")


@pytest.mark.parametrize("name", ["energy", "density"])
def test_the_second_time_no_row_is_read(dataset, truck, monkeypatch, name):
    ask = {"energy": lambda d: energy(d, truck), "density": density}[name]
    first = ask(dataset)
    monkeypatch.setattr(Dataset, "pieces", no_reading)
    monkeypatch.setattr(Dataset, "read", no_reading)
    again = ask(Dataset(dataset.path))
    assert again.summary == first.summary
    assert all(again.tables[n].equals(first.tables[n]) for n in first.tables)


def test_other_parameters_are_another_question(dataset, truck):
    energy(dataset, truck)
    one = len(kept(dataset))
    energy(dataset, truck.with_value("drive.efficiency", 0.7))
    assert len(kept(dataset)) == 2 * one == 2 * len(dataset.vehicle_days)


def test_changed_rows_are_read_again(dataset, truck):
    import os

    first = energy(dataset, truck)
    vehicle, date = dataset.vehicle_days[0]
    part = dataset.parts(vehicle, date)[0]
    data = part.read_bytes()
    part.unlink()  # the fixture shares the file
    part.write_bytes(dataset.parts(vehicle, dataset.dates[1])[0].read_bytes())
    assert energy(Dataset(dataset.path), truck).summary != first.summary
    part.write_bytes(data)
    os.utime(part, (1e9, 1e9))
    assert energy(Dataset(dataset.path), truck).summary == first.summary


def test_damaged_or_foreign_results_are_made_again(dataset, truck):
    first = energy(dataset, truck)
    one, two, three = kept(dataset)[:3]
    one.write_bytes(one.read_bytes()[:-5])
    two.write_bytes(two.read_bytes()[:32] + pack({"energy": Thing("a", np.zeros(3))}))
    three.unlink()
    assert energy(Dataset(dataset.path), truck).summary == first.summary


def test_a_dataset_that_cannot_be_written_goes_without(dataset, truck):
    (dataset.path / ".partials").write_text("in the way")
    expected = energy(dataset, truck).summary
    assert energy(Dataset(dataset.path), truck).summary == expected


def test_questions_asked_longest_ago_go(dataset, truck, monkeypatch):
    from fleetlog.simulate.places import find_stands

    monkeypatch.setattr(partials, "QUESTIONS", 2)
    for efficiency in (0.6, 0.7, 0.8):
        energy(dataset, truck.with_value("drive.efficiency", efficiency))
    find_stands(dataset)
    assert len(list((dataset.path / ".partials").iterdir())) == 2


def test_small_datasets_keep_nothing(fleet, truck):
    energy(fleet, truck)
    assert not (fleet.path / ".partials").exists()


def test_a_changed_term_is_another_question(dataset, truck, monkeypatch):
    import inspect

    energy(dataset, truck)
    one = len(kept(dataset))
    source = inspect.getsource
    monkeypatch.setattr(inspect, "getsource", lambda module: source(module) + "# changed")
    energy(dataset, truck)
    assert len(kept(dataset)) == 2 * one
