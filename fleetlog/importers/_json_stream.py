"""The features of a GeoJSON text one by one, without holding the text."""

import codecs
import json
import re
from collections.abc import Iterator
from io import BufferedReader
from typing import Any

from fleetlog.importers._report import ReadReport

BLOCK = 1 << 18
FEATURE_LIMIT = 1 << 27
"""Characters of one feature that are believed."""
_OPEN = re.compile(r'"features"\s*:\s*\[')
_BETWEEN = re.compile(r"[\s,\x1e\ufeff]*")


def features(stream: BufferedReader, report: ReadReport) -> Iterator[dict[str, Any]]:
    """Every object of a collection's ``features``, or every one at the top (a single one, or one a line).

    Where the text is cut off or broken the features end, and ``report`` hears of it.
    """
    window = _Window(stream)
    window.fill(BLOCK)
    collection = _OPEN.search(window.text)
    if collection:
        window.at = collection.end()
    count = 0
    while True:
        window.skip()
        if window.ended and window.at >= len(window.text):
            if collection:
                report.damaged(f"the text breaks off after {count} features")
            return
        if collection and window.text[window.at] == "]":
            return
        item = window.object()
        if item is None:
            report.damaged(f"the JSON is cut off or wrong in feature {count + 1}")
            return
        count += 1
        yield item


class _Window:
    """The stretch of text that is being looked at."""

    def __init__(self, stream: BufferedReader) -> None:
        self._stream = stream
        self._decoder = json.JSONDecoder(parse_int=_whole)
        self._text_of = codecs.getincrementaldecoder("utf-8-sig")("replace")
        self.text, self.at, self.ended = "", 0, False

    def fill(self, size: int) -> None:
        """Read on, forgetting what is behind."""
        block = self._stream.read(size)
        self.ended = not block
        self.text = self.text[self.at :] + self._text_of.decode(block, final=self.ended)
        self.at = 0

    def skip(self) -> None:
        """Past blanks and commas."""
        while True:
            between = _BETWEEN.match(self.text, self.at)
            assert between is not None
            self.at = between.end()
            if self.at < len(self.text) or self.ended:
                return
            self.fill(BLOCK)

    def object(self) -> dict[str, Any] | None:
        """The JSON object here, reading on (twice as much each time) until it is whole, or None."""
        if self.text[self.at] != "{":
            return None
        size = BLOCK
        while True:
            try:
                item, self.at = self._decoder.raw_decode(self.text, self.at)
            except (ValueError, RecursionError):
                if self.ended or len(self.text) - self.at > FEATURE_LIMIT:
                    return None
                self.fill(size)
                size *= 2
            else:
                return item if isinstance(item, dict) else None


def _whole(text: str) -> int | float:
    """An integer; one of hundreds of digits is beyond any number of a log, and infinite."""
    return int(text) if len(text) < 300 else float(text)
