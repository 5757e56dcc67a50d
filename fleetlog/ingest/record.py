"""Messages of an MQTT broker, captured as one JSON object a line: ``{"topic", "received", "payload"}``.

The session outlives a lost connection: a broker that keeps sessions delivers what was published meanwhile
(quality of service 1).  What a broker forgets when it restarts is lost to every listener.
"""

import json
import threading
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import IO, Any
from urllib.parse import SplitResult, unquote, urlsplit

from fleetlog import interrupt
from fleetlog.errors import InputError

PORTS = {"mqtt": 1883, "mqtts": 8883}
FIRST_ANSWER = 20.0
"""Seconds in which the broker answers for the first time."""
FLUSH = 1.0
"""Messages reach the disk at least this often [s]."""


@dataclass
class Capture:
    """What was captured; ``reconnects`` after the first connection."""

    messages: int = 0
    reconnects: int = 0
    last: float = 0.0


def record(
    url: str, out: IO[str], *, duration: float | None = None, messages: int | None = None,
    client_id: str = "fleetlog",
) -> Capture:  # fmt: skip
    """Write messages to a text file until ``duration`` [s], a number of ``messages``, or an interrupt.

    ``url`` is ``mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC`` (``mqtts`` for TLS); the topic may hold wildcards,
    ``#`` is the default.  ``client_id`` names the session that the broker keeps; captures at once need two.
    :class:`~fleetlog.errors.InputError` where no broker answers, it refuses, or an extra is missing.
    """
    place, topic = _parsed(url)
    listener = _Listener(topic, out, messages)
    client = _client(place, client_id)
    client.on_connect, client.on_message = listener.connected, listener.message
    until = time.monotonic() + duration if duration is not None else None
    try:
        client.connect(str(place.hostname), place.port or PORTS[place.scheme], keepalive=20)
        client.loop_start()
        listener.await_first(url)
        while not listener.done.wait(FLUSH):
            listener.flush()
            if until is not None and time.monotonic() >= until:
                break
    except OSError as error:
        what = f"no broker answers: {error.strerror or error}"
        raise InputError(what, where=url, do="check host and port") from None
    except KeyboardInterrupt:
        if not listener.capture.messages:
            raise
        interrupt.answered()
    finally:
        client.disconnect()
        client.loop_stop()
        listener.flush()
    return listener.capture


def _parsed(url: str) -> tuple[SplitResult, str]:
    try:
        place = urlsplit(url)
        known = place.scheme in PORTS and bool(place.hostname) and (place.port is None or place.port > 0)
    except ValueError:
        known = False
    if not known:
        raise InputError("is no address of a broker", where=url, do="write it as mqtt://HOST:PORT/TOPIC")
    # '#' begins a fragment in a URL and is a wildcard here.
    topic = unquote(place.path.lstrip("/")) + (f"#{place.fragment}" if "#" in url else "")
    return place, topic or "#"


def _client(place: SplitResult, client_id: str) -> Any:
    try:
        import paho.mqtt.client as mqtt
    except ImportError:
        do = 'install it with: pip install "fleetlog[mqtt]"'
        raise InputError("recording needs paho-mqtt", do=do) from None
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=client_id, clean_session=False)
    if place.username:
        client.username_pw_set(unquote(place.username), unquote(place.password or ""))
    if place.scheme == "mqtts":
        client.tls_set()
    client.reconnect_delay_set(min_delay=1, max_delay=8)
    return client


class _Listener:
    """Callbacks of the client, which run in its thread."""

    def __init__(self, topic: str, out: IO[str], most: int | None) -> None:
        self.topic, self.out, self.most = topic, out, most
        self.capture = Capture()
        self.done = threading.Event()
        self._first = threading.Event()
        self._refused = ""
        self._lock = threading.Lock()

    def connected(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        """Subscribe, at first and after every loss of the connection."""
        if reason.is_failure:
            self._refused = str(reason)
        else:
            self.capture.reconnects += self._first.is_set()
            client.subscribe(self.topic, qos=1)
        self._first.set()

    def message(self, _client: Any, _data: Any, message: Any) -> None:
        """One message, as it came."""
        with self._lock:
            if self.done.is_set():
                return
            stamp = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            line = {"topic": message.topic, "received": stamp, "payload": _payload(message.payload)}
            self.out.write(json.dumps(line, separators=(",", ":")) + "\n")
            self.capture.messages += 1
            if self.most is not None and self.capture.messages >= self.most:
                self.done.set()

    def await_first(self, url: str) -> None:
        """Wait for the broker's first answer."""
        if not self._first.wait(FIRST_ANSWER):
            raise InputError("no broker answers", where=url, do="check host and port")
        if self._refused:
            raise InputError(f"the broker refuses: {self._refused}", where=url, do="check user and password")

    def flush(self) -> None:
        """Bring what was written to the disk."""
        with self._lock:
            self.out.flush()


def _payload(data: bytes) -> Any:
    """The JSON of a message; the text of one that is none."""
    text = data.decode("utf-8", "replace")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
