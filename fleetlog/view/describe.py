"""What a recording (``.rrd``) holds, read through Rerun's own reader."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from fleetlog.errors import InputError

AGAIN = "make it again from its dataset"


def describe_recording(path: Path) -> dict[str, Any]:
    """Recordings, entities, rows, timelines and blueprints of a file; InputError where it is unreadable."""
    from rerun.chunk import RrdReader

    try:
        # Rerun warns, and does not raise, where a file was not closed
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            reader = RrdReader(str(path))
            recordings = [
                {"application": s.application_id, "recording": s.recording_id, **_contents(reader, s)}
                for s in reader.recordings()
            ]
            blueprints = len(reader.blueprints())
    except Exception as error:  # Rerun raises its own kinds and RuntimeError alike
        why = " ".join(str(error).split())[:160]
        raise InputError(f"not readable as a recording: {why}", where=path, do=AGAIN) from None
    if not any(r["rows"] for r in recordings):
        raise InputError("no recording with a row in it", where=path, do=AGAIN)
    open_end = any("no footer" in str(w.message) for w in heard)
    damage = ["the recording was not closed: it has no footer"] if open_end else []
    return {"recordings": recordings, "blueprint": blueprints > 0, "damage": damage}


def _contents(reader: Any, store: Any) -> dict[str, Any]:
    entities: dict[str, int] = {}
    timelines: set[str] = set()
    for chunk in reader.stream(store=store):
        path = str(chunk.entity_path)
        entities[path] = entities.get(path, 0) + int(chunk.num_rows)
        timelines |= {str(name) for name in chunk.timeline_names}
    shown = {k: v for k, v in sorted(entities.items()) if not k.startswith("/__")}
    return {"entities": shown, "rows": sum(shown.values()), "timelines": sorted(timelines)}
