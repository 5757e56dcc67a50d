"""Sentences: what a module tells people is whole, beside it, and all of it is used."""

import re
import tomllib
from pathlib import Path
from string import Formatter

import pytest

import fleetlog
from fleetlog.core.words import Sentences, count, percent

FILES = sorted(Path(fleetlog.__file__).parent.rglob("sentences.toml"))
TABLES = [(file, module) for file in FILES for module in tomllib.loads(file.read_text("utf-8"))]


def test_fields_count_and_are_percentages(tmp_path):
    (tmp_path / "sentences.toml").write_text(
        '[one]\nsaid = "{n:count truck}, {share:percent 1}, {m:.2f} m, {a[b].c}"\n'
    )
    said = Sentences(str(tmp_path / "one.py"))
    thing = type("Thing", (), {"c": "x"})
    assert said("said", n=2000, share=0.123, m=1.005, a={"b": thing}) == "2,000 trucks, 12.3 %, 1.00 m, x"
    assert said("said", n=1, share=1, m=0, a={"b": thing}).startswith(f"{count(1, 'truck')}, {percent(1, 1)}")


@pytest.mark.parametrize(("file", "module"), TABLES, ids=lambda part: str(getattr(part, "stem", part)))
def test_every_sentence_is_said_by_its_module(file, module):
    source = file.with_name(f"{module}.py").read_text("utf-8")
    for name, text in tomllib.loads(file.read_text("utf-8"))[module].items():
        assert re.search(rf'"{name}"', source), f"{module} does not say {name}"
        fields = [
            (spec or "").partition(" ") for _, field, spec, _ in Formatter().parse(text) if field is not None
        ]
        assert all(more for how, _, more in fields if how == "count"), "what is counted has a noun"
