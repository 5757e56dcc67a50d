"""Messages of an MQTT broker, captured as one JSON object a line: ``{"topic", "received", "payload"}``.

The session outlives a lost connection: a broker that keeps sessions delivers what was published meanwhile
(quality of service 1).  What a broker forgets when it restarts is lost to every listener."""

import json
import threading
import time
from datetime import UTC, datetime
from typing import IO, Any
from urllib.parse import SplitResult, unquote, urlsplit

from fleetlog import interrupt
from fleetlog.errors import InputError
from fleetlog.listening import notice
from fleetlog.registry import extra

PORTS = {"mqtt": 1883, "mqtts": 8883}
FIRST_ANSWER = 20.0  # Seconds in which the broker answers for the first time


class Capture:
    """What is captured, written by callbacks of the client, which run in its thread."""

    def __init__(self, topic: str, out: IO[str], most: int | None) -> None:
        self.topic, self.out, self.most = topic, out, most
        self.messages = 0
        self.reconnects = 0  # After the first connection
        self.answered, self.done = threading.Event(), threading.Event()
        self.refused = ""
        self.failure: OSError | None = None

    def connected(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        """Subscribe, at first and after every loss of the connection."""
        if reason.is_failure:
            self.refused = str(reason)
        else:
            self.reconnects += self.answered.is_set()
            client.subscribe(self.topic, qos=1)
        self.answered.set()

    def message(self, _client: Any, _data: Any, message: Any) -> None:
        """Bring one message, as it came, to the disk."""
        if self.done.is_set():
            return
        stamp = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        line = {"topic": message.topic, "received": stamp, "payload": _payload(message.payload)}
        try:
            self.out.write(json.dumps(line, separators=(",", ":")) + "\n")
            self.out.flush()
            self.messages += 1
        except OSError as error:
            self.failure = error
        if self.failure is not None or self.messages == self.most:
            self.done.set()


def record(
    url: str, out: IO[str], *, duration: float | None = None, messages: int | None = None,
    client_id: str = "fleetlog",
) -> Capture:  # fmt: skip
    """Write messages to a text file until ``duration`` [s], a number of ``messages``, or an interrupt.

    ``url`` is ``mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC`` (``mqtts`` for TLS); the topic may hold wildcards,
    ``#`` is the default.  ``client_id`` names the session that the broker keeps; captures at once need two.
    :class:`~fleetlog.errors.InputError` where no broker answers, it refuses, or an extra is missing."""
    place, topic = _parsed(url)
    capture, client = Capture(topic, out, messages), _client(place, client_id)
    client.on_connect, client.on_message = capture.connected, capture.message
    notice(f"capturing {url.rpartition('@')[2]}; Ctrl-C ends it and keeps what came")
    until = None if duration is None else time.monotonic() + duration
    no_answer, do = "no broker answers", "check host and port"
    try:
        client.connect(str(place.hostname), place.port or PORTS[place.scheme], keepalive=20)
        client.loop_start()
        if not capture.answered.wait(FIRST_ANSWER):
            raise InputError(no_answer, where=url, do=do)
        if capture.refused:
            raise InputError(f"the broker refuses: {capture.refused}", where=url, do="check the password")
        capture.done.wait(None if until is None else until - time.monotonic())
    except OSError as error:
        raise InputError(f"{no_answer}: {error.strerror or error}", where=url, do=do) from None
    except KeyboardInterrupt:
        if not capture.messages:
            raise
        interrupt.answered()
    finally:
        client.disconnect()
        client.loop_stop()
    if capture.failure is not None:
        raise capture.failure
    return capture


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
    mqtt = extra("paho.mqtt.client", "mqtt", "recording needs paho-mqtt")
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=client_id, clean_session=False)
    if place.username:
        client.username_pw_set(unquote(place.username), unquote(place.password or ""))
    if place.scheme == "mqtts":
        client.tls_set()
    client.reconnect_delay_set(min_delay=1, max_delay=8)
    return client


def _payload(data: bytes) -> Any:
    """The JSON of a message; the text of one that is none."""
    text = data.decode("utf-8", "replace")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
