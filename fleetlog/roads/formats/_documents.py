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

_COMMENTS = re.compile(rb"\s*(?:<!--.*?-->\s*)+", re.DOTALL)
_DECLARATION = re.compile(rb"<\?xml[^>]{0,400}\?>")


def parse_xml(path: Path, root: str, notes: list[str]) -> Element:
    """The root element, namespaces taken off; :class:`SiteError` in one line where it is not well formed.

    Files that declare entities are refused: a map has no use for them.  An XML declaration behind a comment,
    which some tools write, is passed over and noted.
    """
    data = read_whole(path, error=SiteError)
    encoding = None
    comments = _COMMENTS.match(data)
    if comments and (late := _DECLARATION.match(data, comments.end())):
        notes.append("the XML declaration stands behind a comment and is passed over")
        found = re.search(rb"encoding=[\"']([\w.-]+)", late[0])
        encoding = found[1].decode() if found else None
        data = comments[0] + data[late.end() :]
    if b"<!ENTITY" in data:
        raise SiteError("declares XML entities, which are not read", do="remove its DOCTYPE")
    try:
        parser = etree.XMLParser(
            resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=True,
            remove_pis=True, encoding=encoding,
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
    data = read_whole(path, error=SiteError)
    try:
        return json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        what = f"not valid JSON: {error.msg}"
        raise SiteError(what, place=f"line {error.lineno}", do="correct the file") from None
    except (ValueError, RecursionError) as error:
        raise SiteError(f"not readable as JSON: {str(error)[:120]}", do="correct the file") from None
