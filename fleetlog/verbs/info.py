"""Describe a dataset, log, map, site, truck or recording, or a folder that fleetlog wrote."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleetlog.api.answer import Answer
from fleetlog.api.inputs import existing
from fleetlog.api.kinds import DatasetLike
from fleetlog.api.verb import verb
from fleetlog.core.words import count
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE, FleetlogError, FormatError, InputError
from fleetlog.store.output import MARK
from fleetlog.store.places import is_url

if TYPE_CHECKING:
    from fleetlog.core.network import Network
    from fleetlog.store import Dataset

Described = tuple[dict[str, Any], list[str]]  # A summary, and the same as lines for a person
LISTED = 10


@verb()
def info(path: DatasetLike) -> Answer:
    """Describe PATH: a dataset, log, map, site, truck or recording, or a folder that fleetlog wrote.

    Parameters
    ----------
    path : what is to be described.

    Examples
    --------
    >>> import fleetlog
    >>> print(str(fleetlog.info("sample/roads.geojson")).splitlines()[2])
      network   76 directed edges (4 one-way), 27 nodes, 1.35 km
    """
    summary, lines = describe(existing(path))
    status = EXIT_DAMAGED if summary.get("damage") or summary.get("rejected") else EXIT_DONE
    return Answer("info", summary, lines=lines, status=status)


def describe(path: Path) -> Described:
    """What ``path`` holds; :class:`InputError` says what was tried where nothing fits."""
    if is_url(path) or (path / "dataset.json").is_file():
        return _dataset(path)
    if (path / MARK).is_file():
        return _output(path)
    by_suffix = {".rrd": _recording, ".toml": _truck_or_site}
    return by_suffix.get(path.suffix.lower(), _log_or_map)(path)


def _output(path: Path) -> Described:
    """A folder of results: what it is, its files, and the figures of its summary."""
    kind = str(json.loads((path / MARK).read_text(encoding="utf-8"))["kind"])
    names = sorted(p.name for p in path.iterdir() if not p.name.startswith("."))
    document = next((path / n for n in names if n.endswith(".json") and (path / n).is_file()), None)
    figures = {} if document is None else json.loads(document.read_text(encoding="utf-8"))
    lines = [f"{path}: {'an' if kind[0] in 'aeiou' else 'a'} {kind}", f"  files     {', '.join(names)}"]
    for key, value in figures.items():
        if isinstance(value, list) and value:
            lines.append(f"  {key}: {count(len(value), 'entry', 'entries')}")
        elif isinstance(value, str | int | float) and "\n" not in str(value) and key != "format_version":
            lines.append(f"  {key}: {value:.6g}" if isinstance(value, float) else f"  {key}: {value}")
    return {"kind": kind, "path": str(path), "files": names, "summary": figures}, lines


def _log_or_map(path: Path) -> Described:
    """A log where a log format fits and gives rows, else a map; the log's error where it is neither."""
    from fleetlog.importers.base import find

    refusal: FleetlogError | None = None
    if find(path) is not None:
        try:
            return _log(path)
        except FormatError as error:
            refusal = error
    try:
        return _map(path)
    except (FleetlogError, UnicodeDecodeError) as error:
        what = "is no dataset, log, map, truck or recording that fleetlog knows"
        do = f"see docs/logs.md and docs/maps.md (taken as a map: {getattr(error, 'what', error)})"
        if path.is_dir():
            do = "name a file in it, or see what an import would read with fleetlog import --dry-run"
        raise refusal or InputError(what, where=path, do=do) from None


def _dataset(path: Path) -> Described:
    from fleetlog.store import Dataset

    d = Dataset(path)
    meta, site, made = d.meta, d.meta["site"], d.meta["provenance"]
    told = ("format_version", "site", "vehicles", "start", "end", "rows", "columns", "provenance")
    replay = (path / "recording.rrd").is_file()
    counts = {"recorded": d.kind, "trips": len(d.trips), "days": len(d.dates), "replay": replay}
    events, happened = _events(d)
    lines = [
        f"{path}: a {d.kind} dataset (format {meta['format_version']})",
        f"  rows      {d.rows:,} of {_some(d.vehicles)}, {count(len(d.trips), 'trip')}",
        f"  span      {meta['start']} to {meta['end']} ({count(len(d.dates), 'day')})",
        f"  site      {site.get('name', '?')}, {site.get('edges', '?')} directed edges, "
        + _place(site.get("frame")),
        f"  columns   {', '.join(n + (f' [{u}]' if u else '') for n, u in meta['columns'].items())}",
        f"  replay    {'recording.rrd' if replay else 'none'}",
        *happened,
        f"  made by   {made.get('command', 'unknown')} (fleetlog {made.get('version', '?')})",
    ]
    return {"kind": "dataset", "path": str(path), **{k: meta[k] for k in told}, **counts, **events}, lines


def _events(dataset: Dataset) -> Described:
    """What the tables beside the trajectories say; nothing where there are none."""
    from fleetlog.store.events import read_table

    tasks, stretches = read_table(dataset, "tasks"), read_table(dataset, "activities")
    if tasks is None or stretches is None:
        return {}, []
    status = {str(k): int(n) for k, n in tasks["status"].value_counts().items()}
    charging = stretches[stretches["activity"] == "charge"]
    lasted = (stretches["end"] - stretches["start"]).dt.total_seconds()
    hours = lasted.groupby(stretches["activity"]).sum() / 3600.0
    shares = (100.0 * hours / hours.sum()).sort_values(ascending=False, kind="stable")
    reserved = int(dataset.meta["tables"]["reservations"]["rows"])
    unfinished = ", ".join(f"{n} {s}" for s, n in sorted(status.items()) if s != "done")
    summary = {
        "tasks": {"all": len(tasks), **status}, "charging_visits": len(charging), "reservations": reserved,
        "activity_hours": {str(k): round(float(h), 4) for k, h in hours.items()},
    }  # fmt: skip
    return summary, [
        f"  time      {', '.join(f'{name} {share:.0f} %' for name, share in shares.items())}",
        f"  tasks     {status.get('done', 0):,} done of {len(tasks):,}"
        + (f" ({unfinished})" if unfinished else ""),
        f"  charging  {count(len(charging), 'visit')} of {count(charging['vehicle_id'].nunique(), 'truck')}",
        f"  reserved  {count(reserved, 'reservation')} of pieces of road",
    ]


def _place(frame: dict[str, Any] | None) -> str:
    return f"at {frame['latitude']:.5f}, {frame['longitude']:.5f}" if frame else "not placed on earth"


def _some(names: list[str]) -> str:
    shown = ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")
    return f"{count(len(names), 'vehicle')} ({shown})"


def _log(path: Path) -> Described:
    from fleetlog.importers._guard import read_guarded
    from fleetlog.importers._report import ReadReport
    from fleetlog.importers.base import GEOGRAPHIC, LOCAL, ReadOptions, detect

    importer = detect(path)
    report = ReadReport(path, importer.name)
    rows, rejects = Counter[str](), Counter[str]()
    columns: dict[str, None] = {}
    extent: dict[str, list[Any]] = {}
    for batch in read_guarded(importer, path, ReadOptions(report)):
        rejects.update(r.reason for r in batch.rejects)
        columns |= dict.fromkeys(batch.columns if len(batch) else ())
        if batch.has_position:
            codes, counts = np.unique(batch.vehicle.codes, return_counts=True)
            rows.update({batch.vehicle.names[c]: int(n) for c, n in zip(codes, counts, strict=True)})
        positions: dict[str, Any] = {name: batch.columns.get(name, ()) for name in (*GEOGRAPHIC, *LOCAL)}
        for name, values in {"time": batch.time, **positions}.items():
            known = np.asarray(values)[np.isfinite(values)]
            if len(known):
                known = np.append(known, extent.get(name, known[:1]))
                extent[name] = [known.min().item(), known.max().item()]
    if not rows:
        raise FormatError("no row with a position in it", where=path, do="see docs/logs.md")
    start, end = (f"{np.datetime64(int(t), 'us')}Z" for t in extent.pop("time"))
    summary = {
        "kind": "log", "path": str(path), "format": report.format, "rows": sum(rows.values()),
        "vehicles": dict(sorted(rows.items())), "start": start, "end": end, "extent": extent,
        "columns": list(columns), "recognised": report.recognised, "notes": report.notes,
        "damage": report.damage, "rejected": dict(rejects),
    }  # fmt: skip
    return summary, [
        f"{path}: a log ({report.format})",
        f"  rows      {summary['rows']:,} of {_some(sorted(rows))}",
        f"  span      {start} to {end}",
        "  extent    " + ", ".join(f"{n} {low:.6g} to {high:.6g}" for n, (low, high) in extent.items()),
        f"  columns   {', '.join(columns)}",
        *(f"  read as   {source}: {target}" for source, target in report.recognised.items()),
        *(f"  note      {note}" for note in report.notes),
        *(f"  damaged   {damage}" for damage in report.damage),
        *(f"  rejected  {n:,}: {reason}" for reason, n in rejects.most_common()),
    ]


def _map(path: Path) -> Described:
    from fleetlog.roads import load_site

    site, reports = load_site(path)
    kind = "site" if path.suffix.lower() == ".toml" or path.is_dir() else "map"
    frame = None if site.frame is None else asdict(site.frame)
    things = {k: len(getattr(site, k)) for k in ("places", "zones", "buildings")}
    summary: dict[str, Any] = {
        "kind": kind, "path": str(path), "name": site.name, "traffic": site.traffic,
        "reports": [asdict(r) for r in reports], "frame": frame, **things,
    }  # fmt: skip
    lines = [f"{path}: a {kind} ({site.name}), {_place(frame)}, {site.traffic}-hand traffic"]
    for report in reports:
        lines += [f"  roads     {report.line()}", *(f"  note      {note}" for note in report.notes)]
    if site.network is not None:
        figures, described = _network(site.network)
        summary |= figures
        lines += described
    lines.append("  places    " + ", ".join(f"{n} {k}" for k, n in things.items()))
    return summary, lines


def _network(n: Network) -> Described:
    x0, y0, x1, y1 = n.extent
    heights = [float(n.points[:, 2].min()), float(n.points[:, 2].max())] if n.has_elevation else None
    one_way, metres = int((n.reverse < 0).sum()), float(n.length.sum())
    size = {"edges": len(n), "nodes": len(n.node_ids), "length_m": metres, "one_way": one_way}
    return {**size, "extent_m": [x0, y0, x1, y1], "elevation_m": heights}, [
        f"  network   {len(n):,} directed edges ({one_way:,} one-way), {len(n.node_ids):,} nodes, "
        f"{metres / 1000:.2f} km",
        f"  extent    x {x0:.1f} to {x1:.1f} m, y {y0:.1f} to {y1:.1f} m",
        "  elevation " + (f"{heights[0]:.2f} to {heights[1]:.2f} m" if heights else "none in the map"),
    ]


def _truck_or_site(path: Path) -> Described:
    from fleetlog.core.schema import load_toml
    from fleetlog.core.truck import SECTIONS, load_truck, truck_to_dict

    given = load_toml(path).keys()
    if "chassis" not in given:
        if given & {"network", "frame", "place", "zone", "building"}:
            return _map(path)
        raise InputError("is neither a truck ([chassis]) nor a site ([network])", where=path, do="see docs")
    data = truck_to_dict(load_truck(path))
    lines = [f"{path}: a truck ({data['name']})"]
    lines += [f"  {s:<11}{', '.join(f'{k} {v:g}' for k, v in data[s].items())}" for s in SECTIONS]
    return {"kind": "truck", "path": str(path), **data}, lines


def _recording(path: Path) -> Described:
    from fleetlog.view.viewer import describe_recording

    found = describe_recording(path)
    lines = [f"{path}: a Rerun recording, {'with' if found['blueprint'] else 'without'} a blueprint"]
    for r in found["recordings"]:
        head = f"  recording {r['recording']} of {r['application']}: {r['rows']:,} rows"
        lines.append(f"{head}, timelines {', '.join(r['timelines']) or 'none'}")
        lines += [f"  entity    {name}: {rows:,} rows" for name, rows in r["entities"].items()]
    lines += [f"  damaged   {damage}" for damage in found["damage"]]
    return {"kind": "recording", "path": str(path), **found}, lines
