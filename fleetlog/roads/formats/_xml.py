"""XML from outside, parsed without entities, external files or network."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from fleetlog.core.files import read_whole
from fleetlog.errors import SiteError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

_BLANKS = re.compile(rb"\s*")
_DECLARATION = re.compile(rb"<\?xml[^>]{0,400}\?>")


def parse_xml(path: Path, root: str, notes: list[str]) -> Element:
    """The root element, namespaces taken off; :class:`SiteError` in one line where it is not well formed.

    Files that declare entities are refused: a map has no use for them.  An XML declaration behind a comment,
    which some tools write, is passed over and noted.
    """
    from lxml import etree

    data = read_whole(path, error=SiteError)
    encoding = None
    behind = _behind_comments(data)
    if behind and (late := _DECLARATION.match(data, behind)):
        notes.append("the XML declaration stands behind a comment and is passed over")
        found = re.search(rb"encoding=[\"']([\w.-]+)", late[0])
        encoding = found[1].decode() if found else None
        data = data[:behind] + data[late.end() :]
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
    for element in top.iter():
        if isinstance(element.tag, str) and element.tag.startswith("{"):
            element.tag = element.tag.rpartition("}")[2]
    if top.tag != root:
        raise SiteError(f"its root is <{top.tag}>, not <{root}>", do="check the suffix of the file")
    return top


def _behind_comments(data: bytes) -> int:
    """Where the text goes on after the blanks and comments that it begins with."""
    at = _BLANKS.match(data, 0).end()  # type: ignore[union-attr]  # matches anywhere
    while data.startswith(b"<!--", at) and (stop := data.find(b"-->", at)) >= 0:
        at = _BLANKS.match(data, stop + 3).end()  # type: ignore[union-attr]
    return at


def looks_like(head: bytes, root: str) -> bool:
    """Whether ``<root`` stands in the first bytes of a file, in UTF-8 or UTF-16."""
    mark = f"<{root}"
    return any(mark.encode(code) in head for code in ("utf-8", "utf-16-le", "utf-16-be"))
