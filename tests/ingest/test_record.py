"""Capturing from a real broker: nothing lost, a clean end, and a broker that goes away and comes back."""

from __future__ import annotations

import io
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time

import pytest

from fleetlog.errors import InputError
from fleetlog.ingest.record import record

pytest.importorskip("amqtt.broker", reason="the wheel amqtt is not installed")
mqtt = pytest.importorskip("paho.mqtt.client", reason="the extra mqtt is not installed")


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


SERVE = """
import asyncio, sys
from amqtt.broker import Broker
async def main():
    broker = Broker({"listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{sys.argv[1]}"}},
                     "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}}})
    await broker.start()
    await asyncio.sleep(3600)
asyncio.run(main())
"""


class Broker:
    """amqtt in a process of its own, which ends as a broker does whose machine fails."""

    def __init__(self, port: int) -> None:
        self.port = port

    def __enter__(self) -> Broker:
        self.process = subprocess.Popen(
            [sys.executable, "-c", SERVE, str(self.port)], stderr=subprocess.DEVNULL
        )
        for _ in range(200):
            with socket.socket() as s:
                if s.connect_ex(("127.0.0.1", self.port)) == 0:
                    return self
            time.sleep(0.1)
        raise AssertionError("the broker does not start")

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(20)


def state(i: int) -> str:
    return json.dumps({"headerId": i, "timestamp": f"2026-03-02T05:{i // 60 % 60:02d}:{i % 60:02d}Z", "version": "2.0.0",
                       "manufacturer": "m", "serialNumber": "7", "agvPosition": {"x": i, "y": 0, "theta": 0, "mapId": "a"}})  # fmt: skip


def capture(port: int, out: io.StringIO, **options):
    """A capture in a thread; its result is put into the list that is returned."""
    done: list = []
    target = lambda: done.append(record(f"mqtt://127.0.0.1:{port}/uagv/#", out, **options))
    thread = threading.Thread(target=target, daemon=True)
    thread.start()
    time.sleep(1.5)
    return thread, done


def publisher(port: int):
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.loop_start()
    return client


def wait_for(what, seconds: float = 20.0) -> None:
    until = time.monotonic() + seconds
    while not what() and time.monotonic() < until:
        time.sleep(0.1)


def headers(out: io.StringIO) -> list[int]:
    return [json.loads(line)["payload"]["headerId"] for line in out.getvalue().splitlines()]


def test_every_message_is_captured_and_imported(tmp_path):
    port, count, out = free_port(), 1000, io.StringIO()
    with Broker(port):
        thread, done = capture(port, out, messages=count)
        client = publisher(port)
        for i in range(count):
            client.publish("uagv/v2/m/7/state", state(i), qos=1)
        thread.join(60)
        client.disconnect()
        client.loop_stop()
    assert done and done[0].messages == count
    assert sorted(headers(out)) == list(range(count))
    (tmp_path / "log.jsonl").write_text(out.getvalue())
    from fleetlog.importers._open import ReadReport
    from fleetlog.importers.base import ReadOptions, detect

    path = tmp_path / "log.jsonl"
    batches = list(detect(path).read(path, ReadOptions(ReadReport(path))))
    assert sum(len(b) for b in batches) == count


def test_a_broker_that_comes_back_is_listened_to_again():
    port, out = free_port(), io.StringIO()
    with Broker(port):
        thread, done = capture(port, out, messages=60)
        client = publisher(port)
        for i in range(30):
            client.publish("uagv/v2/m/7/state", state(i), qos=1).wait_for_publish(10)
        client.disconnect()
        client.loop_stop()
        wait_for(lambda: len(headers(out)) == 30)
    with Broker(port):
        time.sleep(5.0)
        client = publisher(port)
        for i in range(30, 60):
            client.publish("uagv/v2/m/7/state", state(i), qos=1)
        thread.join(30)
        client.disconnect()
        client.loop_stop()
    assert done, len(headers(out))
    assert done[0].reconnects >= 1
    assert sorted(set(headers(out))) == list(range(60))


@pytest.fixture
def mosquitto(tmp_path):
    """A broker that keeps sessions and messages on the disk; ``start`` and ``stop`` it."""
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    port = free_port()
    (tmp_path / "m.conf").write_text(
        f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence true\npersistence_location {tmp_path}/\n"
        "max_queued_messages 0\nmax_inflight_messages 20\n"
        + ("user root\n" if os.geteuid() == 0 else "")
    )  # fmt: skip
    running: list[subprocess.Popen] = []

    class Mosquitto:
        def start(self) -> int:
            running.append(
                subprocess.Popen([program, "-c", str(tmp_path / "m.conf")], stderr=subprocess.DEVNULL)
            )
            wait_for(lambda: answers(port))
            return port

        def stop(self) -> None:
            running[-1].terminate()
            running.pop().wait(20)

    yield Mosquitto()
    for process in running:
        process.kill()


def answers(port: int) -> bool:
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def test_ten_thousand_messages_and_a_broker_restarted_among_them(mosquitto):
    """The truck goes on sending while the broker is away; its own queue, the broker's disk and the session keep all.

    What was under way comes twice (quality of service 1), so the capture ends a little above the count.
    """
    count, twice, out = 10_000, 500, io.StringIO()
    port = mosquitto.start()
    thread, done = capture(port, out, messages=count + twice)
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="truck", clean_session=False)
    client.max_queued_messages_set(0)
    client.reconnect_delay_set(1, 1)
    client.connect("127.0.0.1", port)
    client.loop_start()
    for i in range(count):
        if i == count // 2:
            wait_for(lambda: len(out.getvalue()) > 0)
            mosquitto.stop()
        if i == count // 2 + 1000:
            mosquitto.start()
        client.publish("uagv/v2/m/7/state", state(i), qos=1)
    for i in range(count, count + twice):
        client.publish("uagv/v2/m/7/state", state(i), qos=1)
    thread.join(120)
    client.disconnect()
    client.loop_stop()
    assert done, f"{len(headers(out))} of {count} came"
    assert done[0].reconnects >= 1
    assert set(range(count)) <= set(headers(out))


def test_no_broker_is_one_clear_line():
    with pytest.raises(InputError, match="no broker answers"):
        record(f"mqtt://127.0.0.1:{free_port()}/a", io.StringIO())


@pytest.mark.parametrize("url", ["http://a/b", "mqtt:///a", "mqtt://a:99999/b"])
def test_an_address_that_is_none_says_how_to_write_one(url):
    with pytest.raises(InputError, match="mqtt://HOST"):
        record(url, io.StringIO())
