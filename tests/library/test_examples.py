"""Examples in docstrings run as printed, in a folder that holds the sample data as ``sample``."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

from fleetlog.registry import part_names

MODULES = [f"fleetlog.verbs.{name}" for name in part_names("fleetlog.verbs")]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str, sample: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(sample.parent)
    module = importlib.import_module(name)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for attribute in vars(module).values():
        if getattr(attribute, "__module__", None) == name and attribute.__doc__:
            for test in doctest.DocTestFinder(recurse=False).find(
                getattr(attribute, "function", attribute), name
            ):
                runner.run(test)
    assert not runner.failures
