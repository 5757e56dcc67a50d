"""The house of all pages: one set of templates and one style sheet; every text from data is escaped."""

from __future__ import annotations

from functools import cache
from typing import Any

import jinja2
from markupsafe import Markup


@cache
def _house() -> jinja2.Environment:
    house = jinja2.Environment(
        loader=jinja2.PackageLoader("fleetlog.report", "templates"), autoescape=True, trim_blocks=True,
        lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    house.filters["drawn"] = Markup
    return house


def render(template: str, **values: Any) -> str:
    """One self-contained HTML page; all but pictures of our own (filter ``drawn``) is escaped."""
    return _house().get_template(template).render(**values)
