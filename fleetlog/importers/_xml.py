"""Safe, streaming reading of XML from outside: nothing is expanded, fetched or kept."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, ClassVar

from lxml import etree

from fleetlog.errors import FormatError
from fleetlog.importers._rows import Records

LIMIT = 1 << 24  # Bytes between two elements of interest; beyond it is no log but an attack or a mistake
AT_ONCE = 64  # Elements that wait to be dropped, and elements in one that may


class Elements(Records):
    """Elements of the ``wanted`` tags at their ends; like the ``passed`` ones counted, then dropped.

    So memory does not grow with the file. Entities are not expanded, nothing is loaded from elsewhere,
    libxml2's limits on depth and text stay on. A broken file gives what came before; the report says so."""

    wanted: ClassVar[tuple[str, ...]]
    passed: ClassVar[tuple[str, ...]] = ()
    _since = 0  # Bytes since the last element

    def read(self, size: int = -1) -> bytes:
        """For the parser."""
        data = self.stream.read(min(size, 1 << 15) if size > 0 else 1 << 15)
        self._since += len(data)
        if self._since > LIMIT:
            what = f"one element holds more than {LIMIT >> 20} MB of XML"
            raise FormatError(what, where=self.path, do="this is no log; leave it out")
        return data

    def records(self) -> Iterator[Any]:
        """The wanted elements."""
        events = etree.iterparse(
            self, events=("end",), tag=[f"{{*}}{t}" for t in (*self.wanted, *self.passed)],
            resolve_entities=False, no_network=True, load_dtd=False, dtd_validation=False, huge_tree=False,
        )  # fmt: skip
        try:
            for number, (_, element) in enumerate(events):
                self._since = 0
                tag = bare(element.tag)
                self.seen[tag] += 1
                if tag in self.wanted:
                    yield element
                if len(element) > AT_ONCE:
                    element.clear()
                if not number % AT_ONCE:
                    _forget(element)
        except etree.XMLSyntaxError as error:
            line = f"line {error.position[0]}" if error.position and error.position[0] else "the start"
            why = " ".join(str(error).split())[:120]
            self.report.damaged(f"the XML breaks off or is wrong at {line} ({why})")


def _forget(element: Any) -> None:
    """Drop what stands before an element whose end was seen, and before all that it is in, but for names."""
    while (parent := element.getparent()) is not None:
        name = next(element.itersiblings("{*}name", preceding=True), None)
        del parent[0 if name is None else parent.index(name) + 1 : parent.index(element)]
        element = parent


@lru_cache(1 << 10)
def bare(tag: Any) -> str:
    """A tag without its namespace; ``""`` for comments and instructions."""
    return tag.rsplit("}", 1)[-1] if isinstance(tag, str) else ""
