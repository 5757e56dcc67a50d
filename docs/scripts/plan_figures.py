"""Figures and tables of the page on planning: five experiments on the sample plant.

python docs/scripts/plan_figures.py [QUESTION...]      writes docs/figures/plan_*.png and prints the tables that the page quotes
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
SAMPLE = ROOT / "sample_data"
SITE, LIKE = "--site site.toml --truck truck.toml", "--like recorded --truck truck.toml"
QUESTIONS = {
    "trucks": f"{LIKE} --vehicles 4..12..2 --runs 5 --duration 2h",
    "plugs": f"{SITE} --vehicles 8 --vary plugs=1..5 --runs 3 --soc 0.5 --duration 12h",
    "one_way": f"{SITE} --vehicles 14 --vary close=-b-aisle-10+-b-aisle-11,b-aisle-10+b-aisle-11,"
    "-a-aisle-30+-a-aisle-31,a-aisle-30+a-aisle-31 --runs 5 --duration 1h",
    "closed": f"{LIKE} --vary close=gate-0,gate-1,yard-1,a-cross-10 --runs 5 --duration 1h",
    "pick_place": f"{SITE} --vehicles 8,14,20 --vary dock-1=1,2 --runs 5 --duration 1h",
}


def main() -> None:
    from fleetlog.cli.main import cli

    def fleetlog(*arguments: str) -> None:
        cli(arguments, standalone_mode=False)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in ("site.toml", "roads.geojson", "truck.toml"):
            shutil.copy(SAMPLE / file, folder / file)
        files = {"site.toml", "truck.toml", "recorded"}
        log = [str(SAMPLE / "logs"), "--site", str(folder / "site.toml")]
        with contextlib.suppress(SystemExit):  # some rows of the sample logs are rejected: that is status 3
            fleetlog("import", *log, "-o", str(folder / "recorded"), "-q")
        for question in sys.argv[1:] or QUESTIONS:
            words = [str(folder / w) if w in files else w for w in QUESTIONS[question].split()]
            print(f"\nfleetlog simulate {QUESTIONS[question]} -o {question}", flush=True)
            fleetlog("simulate", *words, "-o", str(folder / question))
            picture = folder / question / "experiment.png"
            shutil.copy(picture, ROOT / "docs" / "figures" / f"plan_{question}.png")


if __name__ == "__main__":
    main()
