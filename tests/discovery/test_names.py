"""The diagnosis knows no term by name: a term says all there is to say of itself."""

from __future__ import annotations

import ast
from pathlib import Path

from fleetlog.core.motion import Motion
from fleetlog.physics.power import all_terms

ORDINARY = {*Motion.__dataclass_fields__, "mass"}
"""Names of recorded variables, which some terms and parameters share."""


def test_no_file_of_discovery_holds_the_name_of_a_term_or_of_its_parameters(project_root: Path) -> None:
    names = {t.name for t in all_terms().values()} | {
        p.name for t in all_terms().values() for p in t.parameters
    }
    found = [
        (str(file.relative_to(project_root)), node.lineno, node.value)
        for file in sorted((project_root / "fleetlog" / "discovery").rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and node.value in names - ORDINARY
    ]
    assert found == []
