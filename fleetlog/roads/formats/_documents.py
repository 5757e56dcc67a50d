"""XML and JSON from outside; XML is parsed without entities, external files or network."""

import json
import re
from pathlib import Path
from typing import Any

from lxml import etree
from lxml.etree import _Element as Element

from fleetlog.core.files import read_whole
from fleetlog.errors import SiteError

__all__ = ["Element", "parse_xml", "read_json"]
_LATE = re.compile(rb"\A(?>\s*(?:<!--(?>.*?-->)\s*)+)(?=<\?xml)", re.DOTALL)  # Comments before a declaration


def parse_xml(path: Path, root: str, notes: list[str]) -> Element:
    """The root element, namespaces taken off; :class:`SiteError` where it is not well formed, or declares
    entities: a map has no use for them. A comment before the XML declaration is passed over and noted."""
    data, late = _LATE.subn(b"", read_whole(path, error=SiteError))
    if late:
        notes.append("the XML declaration stands after a comment, which is skipped")
    if b"<!ENTITY" in data:
        raise SiteError("declares XML entities, which are not read", do="remove its DOCTYPE")
    try:
        parser = etree.XMLParser(
            resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=True,
            remove_pis=True,
        )  # fmt: skip
        top = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, LookupError, ValueError) as error:
        text = str(error).splitlines()[0] if str(error) else "empty"
        raise SiteError(f"not well-formed XML: {text}", do="export the map again") from None
    if top.getroottree().docinfo.internalDTD is not None:
        raise SiteError("has a DOCTYPE with declarations, which is not read", do="remove its DOCTYPE")
    for element in top.iter("{*}*"):
        element.tag = etree.QName(element).localname
    if top.tag != root:
        raise SiteError(f"its root is <{top.tag}>, not <{root}>", do="check the suffix of the file")
    return top


def read_json(path: Path) -> Any:
    """What a file says, or a :class:`SiteError` that names the line."""
    try:
        return json.loads(read_whole(path, error=SiteError).decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        what = f"not valid JSON: {error.msg}"
        raise SiteError(what, place=f"line {error.lineno}", do="correct the file") from None
    except (ValueError, RecursionError) as error:
        raise SiteError(f"not readable as JSON: {str(error)[:120]}", do="correct the file") from None
