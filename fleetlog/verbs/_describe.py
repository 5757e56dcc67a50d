"""What a path holds, for ``fleetlog info``: a summary as a dictionary, and the same as lines for a person."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleetlog.core.words import count
from fleetlog.errors import FleetlogError, FormatError, InputError
from fleetlog.store.output import MARK
from fleetlog.store.places import is_url

if TYPE_CHECKING:
    from fleetlog.core.site import Site
    from fleetlog.store import Dataset

Described = tuple[dict[str, Any], list[str]]
MAPS = (".xodr", ".graphml", ".osm")
LISTED = 10


def describe(path: Path) -> Described:
    """A dataset, log, map, site, truck or recording, or another folder that fleetlog wrote;
    :class:`InputError` says what was tried where nothing fits.
    """
    if is_url(path) or (path / "dataset.json").is_file():
        return _dataset(path)
    if (path / MARK).is_file():
        return _output(path)
    suffix = path.suffix.lower()
    if suffix == ".rrd":
        return _recording(path)
    if suffix == ".toml":
        return _toml(path)
    if suffix in MAPS:
        return _map(path)
    return _log_or_map(path)


def _output(path: Path) -> Described:
    """A folder of results: what it is, its files, and the figures of its summary."""
    made = json.loads((path / MARK).read_text(encoding="utf-8"))
    names = sorted(p.name for p in path.iterdir() if not p.name.startswith("."))
    documents = [n for n in names if n.endswith(".json") and (path / n).is_file()]
    figures = json.loads((path / documents[0]).read_text(encoding="utf-8")) if documents else {}
    kind = str(made["kind"])
    summary = {"kind": kind, "path": str(path), "files": names, "summary": figures}
    lines = [f"{path}: {'an' if kind[0] in 'aeiou' else 'a'} {kind}", f"  files     {', '.join(names)}"]
    for key, value in figures.items():
        if isinstance(value, list) and value:
            lines.append(f"  {key}: {count(len(value), 'entry', 'entries')}")
        elif isinstance(value, str | int | float) and "\n" not in str(value) and key != "format_version":
            lines.append(f"  {key}: {value:.6g}" if isinstance(value, float) else f"  {key}: {value}")
    return summary, lines


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
        if refusal is not None:
            raise refusal from None
        raise InputError(
            "is no dataset, log, map, truck or recording that fleetlog knows",
            where=path,
            do="name a file in it, or see what an import would read with fleetlog import --dry-run"
            if path.is_dir()
            else f"see docs/logs.md and docs/maps.md (taken as a map: {getattr(error, 'what', error)})",
        ) from None


def _dataset(path: Path) -> Described:
    from fleetlog.store import Dataset

    d = Dataset(path)
    meta = d.meta
    told = ("format_version", "site", "vehicles", "start", "end", "rows", "columns", "provenance")
    summary = {"kind": "dataset", "path": str(path), **{k: meta[k] for k in told}}
    summary |= {"recorded": d.kind, "trips": len(d.trips), "days": len(d.dates)}
    summary["replay"] = (path / "recording.rrd").is_file()
    where = meta["site"]
    events, happened = _events(d)
    summary |= events
    lines = [
        f"{path}: a {d.kind} dataset (format {meta['format_version']})",
        f"  rows      {d.rows:,} of {_some(d.vehicles, 'vehicle')}, {count(len(d.trips), 'trip')}",
        f"  span      {meta['start']} to {meta['end']} ({count(len(d.dates), 'day')})",
        f"  site      {where['name']}, {where['edges']} directed edges, " + _place(where.get("frame")),
        f"  columns   {', '.join(n + (f' [{u}]' if u else '') for n, u in meta['columns'].items())}",
        f"  replay    {'recording.rrd' if summary['replay'] else 'none'}",
        *happened,
        f"  made by   {meta['provenance'].get('command', 'unknown')} (fleetlog "
        f"{meta['provenance'].get('version', '?')})",
    ]
    return summary, lines


def _events(dataset: Dataset) -> Described:
    """What the tables beside the trajectories say; nothing where there are none."""
    from fleetlog.store.events import read_table

    tasks, stretches = read_table(dataset, "tasks"), read_table(dataset, "activities")
    if tasks is None or stretches is None:
        return {}, []
    status = {str(k): int(n) for k, n in tasks["status"].value_counts().items()}
    charging = stretches[stretches["activity"] == "charge"]
    hours = (stretches["end"] - stretches["start"]).dt.total_seconds().groupby(
        stretches["activity"]
    ).sum() / 3600.0
    reserved = int(dataset.meta["tables"]["reservations"]["rows"])
    summary = {
        "tasks": {"all": len(tasks), **status}, "charging_visits": len(charging), "reservations": reserved,
        "activity_hours": {str(k): round(float(h), 4) for k, h in hours.items()},
    }  # fmt: skip
    open_ = ", ".join(f"{n} {s}" for s, n in sorted(status.items()) if s != "done")
    shares = (hours / hours.sum()).sort_values(ascending=False, kind="stable")
    lines = [
        f"  time      {', '.join(f'{name} {100.0 * share:.0f} %' for name, share in shares.items())}",
        f"  tasks     {status.get('done', 0):,} done of {len(tasks):,}" + (f" ({open_})" if open_ else ""),
        f"  charging  {count(len(charging), 'visit')} of {count(charging['vehicle_id'].nunique(), 'truck')}",
        f"  reserved  {count(reserved, 'reservation')} of pieces of road",
    ]
    return summary, lines


def _place(frame: dict[str, Any] | None) -> str:
    return f"at {frame['latitude']:.5f}, {frame['longitude']:.5f}" if frame else "not placed on earth"


def _some(names: list[str], noun: str) -> str:
    shown = ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")
    return f"{count(len(names), noun)} ({shown})"


def _log(path: Path) -> Described:
    from fleetlog.importers._guard import read_guarded
    from fleetlog.importers._report import ReadReport
    from fleetlog.importers.base import GEOGRAPHIC, LOCAL, ReadOptions, detect

    importer = detect(path)
    report = ReadReport(path, importer.name)
    rows: Counter[str] = Counter()
    rejects: Counter[str] = Counter()
    columns: dict[str, None] = {}
    span: list[int] = []
    extent: dict[str, list[float]] = {}
    for batch in read_guarded(importer, path, ReadOptions(report)):
        rejects.update(r.reason for r in batch.rejects)
        if not len(batch):
            continue
        columns |= dict.fromkeys(batch.columns)
        codes, counts = np.unique(batch.vehicle.codes, return_counts=True)
        if batch.has_position:
            rows.update({batch.vehicle.names[c]: int(n) for c, n in zip(codes, counts, strict=True)})
        span = [min([*span[:1], int(batch.time.min())]), max([*span[1:], int(batch.time.max())])]
        for name in (*GEOGRAPHIC, *LOCAL):
            _widen(extent, name, batch.columns.get(name))
    if not rows:
        raise FormatError("no row with a position in it", where=path, do="see docs/logs.md")
    start, end = (f"{np.datetime64(t, 'us')}Z" for t in span)
    summary = {
        "kind": "log", "path": str(path), "format": report.format, "rows": sum(rows.values()),
        "vehicles": dict(sorted(rows.items())), "start": start, "end": end, "extent": extent,
        "columns": list(columns), "recognised": report.recognised, "notes": report.notes,
        "damage": report.damage, "rejected": dict(rejects),
    }  # fmt: skip
    lines = [
        f"{path}: a log ({report.format})",
        f"  rows      {summary['rows']:,} of {_some(sorted(rows), 'vehicle')}",
        f"  span      {start} to {end}",
        "  extent    " + ", ".join(f"{n} {low:.6g} to {high:.6g}" for n, (low, high) in extent.items()),
        f"  columns   {', '.join(columns)}",
        *(f"  read as   {source}: {target}" for source, target in report.recognised.items()),
        *(f"  note      {note}" for note in report.notes),
        *(f"  damaged   {damage}" for damage in report.damage),
        *(f"  rejected  {n:,}: {reason}" for reason, n in rejects.most_common()),
    ]
    return summary, lines


def _widen(extent: dict[str, list[float]], name: str, values: Any) -> None:
    known = np.asarray(values, float) if values is not None else np.zeros(0)
    known = known[np.isfinite(known)]
    if len(known):
        low, high = extent.get(name, [np.inf, -np.inf])
        extent[name] = [min(low, float(known.min())), max(high, float(known.max()))]


def _map(path: Path) -> Described:
    from fleetlog.roads import load_site

    site, reports = load_site(path)
    summary: dict[str, Any] = {
        "kind": "site" if path.suffix.lower() == ".toml" or path.is_dir() else "map",
        "path": str(path),
    }
    summary |= {"name": site.name, "traffic": site.traffic, "reports": [asdict(r) for r in reports]}
    frame = site.frame
    summary["frame"] = None if frame is None else asdict(frame)
    summary |= {k: len(getattr(site, k)) for k in ("places", "zones", "buildings")}
    lines = [
        f"{path}: a {summary['kind']} ({site.name}), {_place(summary['frame'])}, {site.traffic}-hand traffic"
    ]
    for report in reports:
        lines += [f"  roads     {report.line()}", *(f"  note      {note}" for note in report.notes)]
    if site.network is not None:
        lines += _network(site, summary)
    lines.append("  places    " + ", ".join(f"{summary[k]} {k}" for k in ("places", "zones", "buildings")))
    return summary, lines


def _network(site: Site, summary: dict[str, Any]) -> list[str]:
    n = site.roads()
    x0, y0, x1, y1 = n.extent
    heights = [float(n.points[:, 2].min()), float(n.points[:, 2].max())] if n.has_elevation else None
    one_way = int((n.reverse < 0).sum())
    summary |= {"edges": len(n), "nodes": len(n.node_ids), "length_m": float(n.length.sum())}
    summary |= {"one_way": one_way, "extent_m": [x0, y0, x1, y1], "elevation_m": heights}
    return [
        f"  network   {len(n):,} directed edges ({one_way:,} one-way), {len(n.node_ids):,} nodes, "
        f"{n.length.sum() / 1000:.2f} km",
        f"  extent    x {x0:.1f} to {x1:.1f} m, y {y0:.1f} to {y1:.1f} m",
        "  elevation " + (f"{heights[0]:.2f} to {heights[1]:.2f} m" if heights else "none in the map"),
    ]


def _toml(path: Path) -> Described:
    from fleetlog.core.schema import load_toml

    data = load_toml(path)
    if "chassis" in data:
        return _truck(path)
    if {"network", "frame", "place", "zone", "building"} & data.keys():
        return _map(path)
    raise InputError("is neither a truck ([chassis]) nor a site ([network])", where=path, do="see docs")


def _truck(path: Path) -> Described:
    from fleetlog.core.truck import load_truck, truck_to_dict

    data = truck_to_dict(load_truck(path))
    lines = [f"{path}: a truck ({data.get('name', 'truck')})"]
    for section, values in data.items():
        if isinstance(values, dict):
            lines.append(
                f"  {section:<11}"
                + ", ".join(f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in values.items())
            )
    return {"kind": "truck", "path": str(path), **data}, lines


def _recording(path: Path) -> Described:
    from fleetlog.view.viewer import describe_recording

    found = describe_recording(path)
    lines = [f"{path}: a Rerun recording, {'with' if found['blueprint'] else 'without'} a blueprint"]
    for r in found["recordings"]:
        lines += [
            f"  recording {r['recording']} of {r['application']}: {r['rows']:,} rows, "
            f"timelines {', '.join(r['timelines']) or 'none'}",
            *(f"  entity    {name}: {rows:,} rows" for name, rows in r["entities"].items()),
        ]
    lines += [f"  damaged   {damage}" for damage in found["damage"]]
    return {"kind": "recording", "path": str(path), **found}, lines
