"""Capture the VDA 5050 messages of an MQTT broker."""

from typing import Annotated

from fleetlog.api.answer import Answer
from fleetlog.api.inputs import PathLike, as_path
from fleetlog.api.verb import verb
from fleetlog.core.arguments import Between, Named


@verb()
def record(
    url: Annotated[str, Named("mqtt://HOST[:PORT]/TOPIC")], *, output: PathLike,
    duration: Annotated[float, Between(0.0, 1e9, above=True)] | None = None,
    messages: Annotated[int, Between(1, 1_000_000_000, whole=True)] | None = None,
    client_id: str = "fleetlog", overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Capture the messages of an MQTT broker until Ctrl-C, for ``fleetlog import``.

    Parameters
    ----------
    url : the broker and the topic, with wildcards; all topics by default.
    output : file of JSON lines.
    duration : stop after this many seconds.
    messages : stop after this many messages.
    client_id : name of the session that the broker keeps."""
    from fleetlog.ingest.record import record as capture
    from fleetlog.store.output import atomic_output

    file = as_path(output)
    with (
        atomic_output(file, "capture", overwrite=overwrite, folder=False) as scratch,
        scratch.open("w", encoding="utf-8") as out,
    ):
        found = capture(url, out, duration=duration, messages=messages, client_id=client_id)
    again = f", {found.reconnects} reconnects" if found.reconnects else ""
    summary = {"messages": found.messages, "reconnects": found.reconnects}
    lines = [f"{found.messages:,} messages captured{again}"]
    return Answer("record", summary, lines=lines, output=file, kind="capture", folder=False)
