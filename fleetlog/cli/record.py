"""``fleetlog record``: VDA 5050 messages of a broker, captured live."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import (
    Between,
    json_option,
    notice,
    output_option,
    overwrite_option,
    quiet_option,
    say,
)


@click.command("record")
@click.argument("url", metavar="mqtt://HOST[:PORT]/TOPIC")
@click.option("--duration", type=Between(0.0, 1e9, min_open=True), help="Stop after this many seconds.")
@click.option("--messages", type=click.IntRange(1), help="Stop after this many messages.")
@click.option("--client-id", default="fleetlog", show_default=True, help="Session that the broker keeps.")
@output_option("File of JSON lines.")
@overwrite_option
@json_option
@quiet_option
def command(
    url: str, duration: float | None, messages: int | None, client_id: str, output: Path, overwrite: bool,
    as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Capture the messages of an MQTT broker until Ctrl-C, for fleetlog import."""
    from fleetlog.ingest.record import record
    from fleetlog.store.output import atomic_output

    with atomic_output(output, "capture", overwrite=overwrite, folder=False) as scratch:
        notice(f"capturing {url.rpartition('@')[2]}; Ctrl-C ends it and keeps what came", quiet)
        with scratch.open("w", encoding="utf-8") as out:
            found = record(url, out, duration=duration, messages=messages, client_id=client_id)
    lost = f", {found.reconnects} reconnects" if found.reconnects else ""
    summary = {"file": str(output), "messages": found.messages, "reconnects": found.reconnects}
    say([f"{found.messages:,} messages written to {output}{lost}"], summary, as_json=as_json, quiet=quiet)
