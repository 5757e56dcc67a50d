"""OSM turn restrictions whose via is a node."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleetlog.core.network import Edge
from fleetlog.roads.formats.base import Tally

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def tags(element: Element) -> dict[str, str]:
    """The tags of an element."""
    return {str(t.get("k")): t.get("v") or "" for t in element.iterfind("tag")}


def forbidden_turns(
    root: Element, parts: dict[str, list[Edge]], edges: list[Edge], tally: Tally
) -> frozenset[tuple[str, str]]:
    """(edge id, next edge id) that ``no_*`` relations forbid, or that ``only_*`` ones do not allow."""
    leaving: dict[str, list[str]] = {}
    for edge in edges:
        leaving.setdefault(edge.start, []).append(edge.id)
    out: set[tuple[str, str]] = set()
    unread = 0
    for relation in root.iterfind("relation"):
        tag = tags(relation)
        rule = tag.get("restriction", "")
        if tag.get("type") != "restriction" or not rule.startswith(("no_", "only_")):
            continue
        named = relation.iterfind("member")
        members = {str(m.get("role")): (m.get("type"), str(m.get("ref"))) for m in named}
        kind, via = members.get("via", (None, ""))
        if kind != "node":
            unread += 1
            continue
        incoming = [e.id for e in parts.get(members.get("from", ("", ""))[1], ()) if e.end == via]
        onward = {e.id for e in parts.get(members.get("to", ("", ""))[1], ()) if e.start == via}
        if rule.startswith("only_"):
            # Without the way that it leads to (beyond the extract) the rule would close the road.
            onward = set(leaving.get(via, ())) - onward if onward else set()
        out |= {(a, b) for a in incoming for b in onward}
    if unread:
        tally.notes.append(f"{unread} turn restrictions that lead over ways are not read")
    return frozenset(out)
