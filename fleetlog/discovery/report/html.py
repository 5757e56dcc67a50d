"""``report.html``: one self-contained page for a fleet engineer, its pictures drawn as SVG."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.result import EdgeValues, Series
from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.discovery.report.finding import Finding

STYLE = """
:root{--ink:#1d2430;--soft:#5c6675;--line:#dfe4ea;--paper:#fff;--panel:#f6f8fa;--warm:#c2410c;--cold:#1d6fb8;--good:#187a4b}
@media (prefers-color-scheme:dark){:root{--ink:#e8ecf1;--soft:#9aa6b5;--line:#323b47;--paper:#151a21;--panel:#1d242d;
--warm:#f08a4b;--cold:#6db3f2;--good:#5cc28e}}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.55 system-ui,sans-serif}
main{max-width:62rem;margin:0 auto;padding:2rem 1.2rem 4rem}h1{font-size:1.7rem;margin:0 0 .3rem}
h2{font-size:1.15rem;margin:2.2rem 0 .6rem}
.lead{font-size:1.1rem;color:var(--soft);margin:0 0 1.4rem}
.card{background:var(--panel);border:1px solid var(--line);border-radius:10px;padding:1.1rem 1.3rem;margin:1rem 0}
.card h3{margin:0 0 .4rem;font-size:1.1rem}table{border-collapse:collapse;width:100%;font-size:.95rem}
td,th{text-align:left;padding:.35rem .6rem;border-bottom:1px solid var(--line)}
th{color:var(--soft);font-weight:600}.num{text-align:right;font-variant-numeric:tabular-nums}.warn{color:var(--warm)}
.two{display:grid;grid-template-columns:1fr 1fr;gap:1rem}
@media(max-width:720px){.two{grid-template-columns:1fr}}svg{width:100%;height:auto;display:block}
figcaption{color:var(--soft);font-size:.9rem}figure{margin:0}
.bar{height:.7rem;border-radius:4px;background:var(--cold)}.bar.best{background:var(--good)}
"""
WORDS = {
    "found": "The model leaves out what is named below.",
    "none": "Nothing is missing: recording and model agree within what the data can tell.",
    "unknown": "Something is missing that no known physics explains; what it follows is said below.",
}
MISMATCH = 1500.0
"""Colours are full at this mean mismatch [W] at most."""


def html(d: Diagnosis, shapes: list[Any]) -> str:
    """The page."""
    v = d.verdict
    parts = [
        f"<h1>Differences between recording and model</h1><p class='lead'>{escape(WORDS[v.word])}</p>",
        _channels(d),
        *(_finding(f) for f in v.findings),
        _maps(shapes, d.fleet.network),
        _curves(shapes),
        _notes(v.notes),
    ]
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
        f"<title>fleetlog diagnosis</title><style>{STYLE}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )


def _channels(d: Diagnosis) -> str:
    rows = "".join(
        f"<tr><td>{escape(c.name)}</td><td>{escape(c.metric)}</td><td class=num>{_share(c.before)}</td>"
        f"<td class=num>{_share(c.after)}</td><td class=num>{_share(c.floor)}</td></tr>"
        for c in d.verdict.channels
    )
    return (
        "<h2>How well the model reproduces the recording</h2><p>On trips that nothing else has read.</p><table><tr><th>Channel</th>"
        f"<th>Error</th><th class=num>before</th><th class=num>after</th><th class=num>noise floor</th></tr>{rows}</table>"
    )


def _share(value: float | None) -> str:
    return "not judged" if value is None else f"{value:.1%}"


def _finding(f: Finding) -> str:
    numbers = "".join(
        f"<tr><td>{escape(p.name)}</td><td class=num>{p.value:.4g}</td><td class=num>{p.low:.4g} to {p.high:.4g}</td>"
        f"<td>{escape(p.unit)}</td></tr>"
        for p in f.parameters
    )
    table = (
        f"<table><tr><th>Quantity</th><th class=num>value</th><th class=num>95 % interval</th><th>unit</th></tr>{numbers}</table>"
        if numbers
        else ""
    )
    doubt = ""
    if f.not_excluded:
        doubt = (
            f"<p class=warn>These data cannot tell it from {escape(', '.join(n.replace('_', ' ') for n in f.not_excluded))}. "
            f"To tell them apart: {escape(f.needs or '')}.</p>"
        )
    elif f.needs:
        doubt = f"<p class=warn>To go on: {escape(f.needs)}.</p>"
    return (
        f"<div class=card><h3>{escape(f.term.replace('_', ' '))} <small>({escape(f.channel)})</small></h3>"
        f"<p>{escape(f.statement)}.</p>{doubt}"
        f"{table}{_ranking(f)}{_where(f)}</div>"
    )


def _ranking(f: Finding) -> str:
    """Bars of what every explanation gains on held-out trips."""
    own = float(f.evidence.get("held_out_gain") or 0.0)
    rows = [
        (f.term, own, True),
        *(
            (str(a["term"]), float(a["held_out_gain"] or 0.0), False)
            for a in f.evidence.get("alternatives", [])
        ),
    ]
    top = max((abs(g) for _, g, _ in rows), default=0.0)
    if top <= 0.0 or len(rows) < 2:
        return ""
    body = "".join(
        f"<tr><td>{escape(n.replace('_', ' '))}</td><td style='width:55%'>"
        f"<div class='bar{' best' if best else ''}' style='width:{100 * max(g, 0) / top:.1f}%'>"
        f"</div></td><td class=num>{g:.4f}</td></tr>"
        for n, g, best in rows
    )
    return f"<h4>What each explanation takes off the error on held-out trips</h4><table>{body}</table>"


def _where(f: Finding) -> str:
    edges = (f.where or {}).get("edges") or []
    if not edges:
        return ""
    rows = "".join(
        f"<tr><td>{escape(e['edge_id'])}</td><td class=num>{e['from']:.0f} to {e['to']:.0f} m</td><td class=num>{e['value']:.4g}</td>"
        f"<td class=num>{e['low']:.4g} to {e['high']:.4g}</td></tr>"
        for e in edges[:20]
    )
    head = "<tr><th>Road</th><th class=num>stretch</th><th class=num>value</th><th class=num>95 % interval</th></tr>"
    return f"<h4>Where</h4><table>{head}{rows}</table>"


def _maps(shapes: list[Any], network: Network | None) -> str:
    drawn = [s for s in shapes if isinstance(s, EdgeValues)]
    if not drawn or network is None:
        return ""
    size = min(
        max(float(np.quantile(np.abs(drawn[0].values), 0.95)) if len(drawn[0].values) else 1.0, 50.0),
        MISMATCH,
    )
    figures = "".join(
        f"<figure>{_map(s, size, network)}<figcaption>{escape(s.name)}: {escape(s.label)}, full colour at {size:.0f} W"
        "</figcaption></figure>"
        for s in drawn
    )
    return f"<h2>Where model and recording differ</h2><div class=two>{figures}</div>"


def _map(shape: EdgeValues, size: float, network: Network) -> str:
    """Stretches as short lines, each direction to the right of the road's middle; red is more than modelled, blue less."""
    low_x, low_y, high_x, high_y = network.extent
    width = 460.0
    scale = (width - 20.0) / max(high_x - low_x, 1.0)
    height = 20.0 + scale * (high_y - low_y)

    def at(points: Any) -> str:
        return " ".join(
            f"{10 + scale * (x - low_x):.1f},{height - 10 - scale * (y - low_y):.1f}" for x, y in points
        )

    roads = "".join(
        f"<polyline fill=none stroke='var(--line)' stroke-width=1 points='{at(network.polyline(i)[:, :2])}'/>"
        for i in range(len(network))
    )
    parts = []
    for edge, start, end, value in zip(shape.edge, shape.start, shape.end, shape.values, strict=True):
        along = np.linspace(start, end, 4)
        place = network.position(np.full(4, edge), along)[:, :2]
        turn = network.heading(np.full(4, edge), along)
        place = place + 2.2 / scale * np.stack([np.sin(turn), -np.cos(turn)], axis=1)
        strength = min(abs(float(value)) / size, 1.0)
        colour = "var(--warm)" if value > 0 else "var(--cold)"
        parts.append(
            f"<polyline fill=none stroke='{colour}' stroke-opacity='{0.08 + 0.92 * strength:.2f}' stroke-width=3"
            f" points='{at(place)}'/>"
        )
    return f"<svg viewBox='0 0 {width:.0f} {height:.0f}' role=img aria-label='{escape(shape.name)}'>{roads}{''.join(parts)}</svg>"


def _curves(shapes: list[Any]) -> str:
    series = [s for s in shapes if isinstance(s, Series)]
    return "".join(
        f"<h2>Power on the trip that the model missed most</h2><figure>{_plot(s)}</figure>" for s in series
    )


def _plot(s: Series) -> str:
    width, height, left = 960.0, 300.0, 60.0
    x = (s.x - s.x[0]).astype(float) * 1e-6
    values = np.concatenate([v[np.isfinite(v)] for v in s.y.values()])
    if not len(values) or x[-1] <= 0:
        return ""
    low, high = float(values.min()), float(values.max())

    def points(y: Any) -> str:
        px = left + (width - left) * x / x[-1]
        py = height - 30 - (height - 50) * (y - low) / max(high - low, 1e-9)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True) if np.isfinite(b))

    colours = {"recorded": "var(--ink)", "model before": "var(--warm)", "model after": "var(--good)"}
    curves = "".join(
        f"<polyline fill=none stroke='{colours.get(n, 'var(--cold)')}' stroke-width=1.6 points='{points(y)}'/>"
        for n, y in s.y.items()
    )
    keys = "".join(
        f"<text x={left + 150 * i:.0f} y=14 fill='{colours.get(n, 'var(--cold)')}' font-size=13>{escape(n)}</text>"
        for i, n in enumerate(s.y)
    )
    small = "font-size=12 fill='var(--soft)'"
    axis = f"<text x=0 y=34 {small}>{high / 1e3:.1f} kW</text><text x=0 y={height - 30:.0f} {small}>{low / 1e3:.1f} kW</text>"
    foot = f"<text x={width - 60:.0f} y={height - 8:.0f} font-size=12 fill='var(--soft)'>{x[-1]:.0f} s</text>"
    return f"<svg viewBox='0 0 {width:.0f} {height:.0f}' role=img aria-label='{escape(s.y_label)}'>{curves}{keys}{axis}{foot}</svg>"


def _notes(notes: list[str]) -> str:
    if not notes:
        return ""
    return "<h2>What the recording lacks</h2><ul>" + "".join(f"<li>{escape(n)}</li>" for n in notes) + "</ul>"
