"""Screenshots of the tutorials: what a new user sees in the first hour.

    python docs/scripts/screenshots.py [NAME...]

runs the commands of docs/tutorials/own-data.md in a scratch folder, as they are printed there, and writes
docs/figures/hour_*.png; ``monday`` makes a recording with three hidden effects and shows its diagnosis.
Needs chromium, and Mesa for the replay.
"""

from __future__ import annotations

import ast
import contextlib
import html
import io
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
FIGURES, TUTORIALS = ROOT / "docs" / "figures", ROOT / "docs" / "tutorials"
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```', re.DOTALL | re.MULTILINE)
WINDOW = """<body style="margin:0;background:#fff"><pre style="margin:10px;padding:14px 18px;border-radius:8px;
background:#1d2129;color:#e4e7ec;font:13px/1.45 'DejaVu Sans Mono',monospace;white-space:pre-wrap">{}</pre>"""
CELL = """<div style="display:flex;margin:6px 0"><code style="width:62px;color:#2b5fa8">In [{}]:</code>
<pre style="flex:1;margin:0;padding:8px 10px;background:#f5f7f9;border:1px solid #dfe4ea;overflow-x:hidden">{}</pre></div>
<div style="margin:4px 0 14px 66px;font:14px sans-serif">{}</div>"""


def shot(page: Path, name: str, width: int, height: int) -> None:
    """A page as chromium draws it, its empty foot cut off, in no more than 256 colours."""
    from PIL import Image, ImageChops

    target = FIGURES / f"{name}.png"
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    command = [
        "chromium",
        *options,
        f"--window-size={width},{height}",
        f"--screenshot={target}",
        page.as_uri(),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=240)
    with Image.open(target) as picture:
        whole = picture.convert("RGB")
    ink = ImageChops.difference(whole, Image.new("RGB", whole.size, "white")).getbbox()
    bottom = min(whole.height, ink[3] + 12) if ink else whole.height
    small = whole.crop((0, 0, whole.width, bottom)).quantize(256, dither=Image.Dither.NONE)
    small.save(target, optimize=True)


def run(words: list[str]) -> str:
    """What a command prints."""
    from click.testing import CliRunner

    from fleetlog.cli.main import cli

    done = CliRunner().invoke(cli, words, standalone_mode=False)
    assert done.return_value in (None, 0, 3), (words, done.exception)
    return done.output


def terminal(commands: dict[str, str], name: str, lines: int) -> None:
    """Commands with the first lines that each prints."""
    parts = []
    for command, text in commands.items():
        said = text.rstrip().splitlines()
        more = ["..."] if len(said) > lines else []
        parts.append("\n".join([f"$ {command}", *said[:lines], *more]))
    page = Path("terminal.html")
    page.write_text(WINDOW.format(html.escape("\n\n".join(parts))), encoding="utf-8")
    shot(page.resolve(), name, 1000, 1400)


def tutorial() -> dict[str, str]:
    """Do all that the tutorial says; what each command printed."""
    from fleetlog.view import viewer

    viewer.show = lambda rrd: None
    said = {}
    for kind, title, text in BLOCK.findall((TUTORIALS / "own-data.md").read_text(encoding="utf-8")):
        if title:
            Path(title).write_text(text, encoding="utf-8")
        elif kind == "console":
            for line in text.splitlines():
                said[line[2:]] = run(shlex.split(line)[2:])
    return said


def hour() -> None:
    """The tutorial on own data: terminal, report, replay, two weeks."""
    said = tutorial()

    def of(start: str) -> dict[str, str]:
        return {
            next(c for c in said if c.startswith(start)): next(
                t for c, t in said.items() if c.startswith(start)
            )
        }

    terminal(
        of("fleetlog import sample/messy/shift.csv --profile profile.toml --dry-run"), "hour_dry_run", 30
    )
    terminal(of("fleetlog import sample/messy/shift.csv --profile profile.toml --site"), "hour_import", 30)
    run(["view", "shift", "--screenshot", "replay.png"])
    from PIL import Image

    with Image.open("replay.png") as picture:
        picture.convert("RGB").resize((1200, 675)).quantize(256).save(
            FIGURES / "hour_replay.png", optimize=True
        )
    shot(Path("shift.html").resolve(), "hour_report", 1100, 1500)
    shot(Path("weeks.html").resolve(), "hour_weeks", 1100, 1200)


def notebook() -> None:
    """The tutorial in a notebook: its cells, and what each shows."""
    run(["demo", "--data", "sample"])
    names: dict[str, object] = {}
    cells = []
    text = (TUTORIALS / "notebook.md").read_text(encoding="utf-8")
    for number, (_, _, code) in enumerate((b for b in BLOCK.findall(text) if b[0] == "python"), start=1):
        cells.append(CELL.format(number, html.escape(code.rstrip()), shown(code, names)))
    page = Path("notebook.html")
    style = "<style>td,th{padding:2px 10px;text-align:right}table{font:13px sans-serif;border-collapse:collapse}</style>"
    page.write_text(f'{style}<body style="margin:14px">{"".join(cells[:3])}', encoding="utf-8")
    shot(page.resolve(), "hour_notebook", 1000, 1900)


def shown(code: str, names: dict[str, object]) -> str:
    """Run a cell; its last expression as a notebook shows it."""
    body = ast.parse(code).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    rich = getattr(value, "_repr_html_", None)
    return html.escape(printed.getvalue()) + (
        rich() if rich else "" if value is None else html.escape(repr(value))
    )


def monday() -> None:
    """The page of a diagnosis: a dragging brake on one truck, a worn road, and a heater left on for an hour.

    They are concealed by the recorder of the blind benchmark, which shares no code with fleetlog.
    """
    import fleetlog

    sys.path.insert(0, str(ROOT / "tests" / "blind"))
    from cases import Case
    from effects import Effect, Scope
    from recorder import record
    from world import world

    case = Case(seed=4090, vehicles=5, hours=4.0)
    w = world(case, [])
    hidden = [
        Effect("rolling_resistance", {"coefficient": 1.6 * w.truck.rolling}, scope=Scope(vehicles=(2,))),
        Effect("surface_resistance", {"factor": 3.0}, (int(w.site.central(5)[0]),)),
        Effect("auxiliary_load", {"power": w.truck.power + 800.0}, scope=Scope(begin=7200.0, end=10800.0)),
    ]
    key = record(case, Path("log"), hidden)
    site = next(p for p in (Path("log/site.toml"), Path("log/roads.geojson")) if p.exists())
    recorded = fleetlog.read_logs("log/recorded.csv.gz", site=site, recording=False)
    found = fleetlog.diagnose(
        recorded, truck="log/truck.toml", channels=("battery_power",), output="diagnosis"
    )
    print("\n".join([str(e) for e in key["effects"]] + found.lines))
    shot(Path("diagnosis/report.html").resolve(), "hour_monday", 1100, 1150)


def main(names: list[str]) -> None:
    """Those asked for, or all."""
    every = {f.__name__: f for f in (hour, notebook, monday)}
    for name in names or every:
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            every[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
