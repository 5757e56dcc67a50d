"""Figures of the pages on density, heat maps and chargers: the sample plant, recorded and simulated.

python docs/scripts/plant_figures.py

writes docs/figures/plant_*.png and prints the figures that the pages quote.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
FIGURES = ROOT / "docs" / "figures"
SAMPLE = ROOT / "sample_data"
K = 5
NUMBERS = ("1", "2", "3", "4", "5")


def fleets(folder: Path) -> dict[str, Path]:
    """The sample logs imported, and a fleet of the same kind simulated."""
    from fleetlog.cli.main import cli

    recorded, simulated = folder / "recorded", folder / "simulated"
    site = str(SAMPLE / "site.toml")
    logs = sorted(str(p) for p in (SAMPLE / "logs").iterdir())
    cli.main(["import", *logs, "--site", site, "-q", "-o", str(recorded)], standalone_mode=False)
    cli.main(
        ["simulate", "--site", site, "--truck", str(SAMPLE / "truck.toml"), "--like", str(recorded),
         "--duration", "30m", "--seed", "1", "--no-recording", "-q", "-o", str(simulated)],
        standalone_mode=False,
    )  # fmt: skip
    return {"recorded": recorded, "simulated": simulated}


def chosen_chargers(data: dict[str, Path]) -> None:
    """Chosen sites over the heat map of the recorded fleet, and how many the simulated one has in common."""
    from scipy.stats import spearmanr

    from fleetlog.analysis.chargers import chargers
    from fleetlog.core.result import Result
    from fleetlog.store import Dataset
    from fleetlog.view.picture import write_picture

    shapes, sites, visits = [], {}, []
    for name, path in data.items():
        result = chargers(Dataset(path), k=K, demand="rank")
        heat, marks = result.shapes[0], result.shapes[1]
        if name == "recorded":
            shapes = [heat, replace(marks, labels=NUMBERS[: len(marks.labels)])]
        visits.append(result.tables["vertices"].set_index("vertex").sort_index().heat_share)
        sites[name] = result.summary["sites"]
        print(
            name,
            json.dumps(
                {k: result.summary[k] for k in ("sites", "reach", "proven_gap", "rank_heat_spearman")}
            ),
        )
    print(
        "Spearman correlation of the fleets' visits per vertex:",
        round(float(spearmanr(*visits).statistic), 2),
    )
    print("sites in common:", len(set(sites["recorded"]) & set(sites["simulated"])), "of", K)
    site = Dataset(data["recorded"]).site
    write_picture(
        Result("chargers over the heat map", {}, shapes=shapes), site, FIGURES / "plant_chargers.png"
    )


def difference(data: dict[str, Path]) -> None:
    """Where the recorded trucks spend more (red) or less (blue) of their time than the simulated ones."""
    from fleetlog.analysis.heatmap import heatmap
    from fleetlog.store import Dataset
    from fleetlog.view.picture import write_picture

    a, b = (Dataset(p) for p in data.values())
    result = heatmap(a, cell=2.0, compare=b)
    print("\n".join(result.lines))
    write_picture(replace(result, name="recorded minus simulated"), a.site, FIGURES / "plant_difference.png")


def one_dock(folder: Path) -> None:
    """Density where one dock gets all the work."""
    from fleetlog.analysis.density import density
    from fleetlog.view.picture import write_picture
    from tests.proofs.one_dock import run

    data, site = run("hall b", folder / "one_dock")
    result = density(data)
    print("\n".join(result.lines))
    write_picture(
        replace(result, name="all work at the dock in hall B"), site, FIGURES / "plant_one_dock.png"
    )


def plan_checked(data: dict[str, Path]) -> None:
    """The plan tried in the simulator."""
    from fleetlog.analysis.chargers import chargers
    from fleetlog.core.truck import load_truck
    from fleetlog.store import Dataset
    from fleetlog.view.picture import write_picture

    recorded = Dataset(data["recorded"])
    result = chargers(
        recorded, k=K, demand="standing", truck=load_truck(SAMPLE / "truck.toml"), check=True, vehicles=8
    )
    print("\n".join(result.lines))
    write_picture(
        replace(result, name="the plan in the simulator"), recorded.site, FIGURES / "plant_check.png"
    )


def shrink(path: Path, most: int = 190_000) -> None:
    """Packed tightly; to 1,200 points in width where the file is large all the same."""
    from PIL import Image

    with Image.open(path) as image:
        image.convert("RGB").save(path, optimize=True)
    if path.stat().st_size > most:
        with Image.open(path) as image:
            small = image.convert("RGB").resize(
                (1200, round(1200 * image.height / image.width)), Image.Resampling.LANCZOS
            )
        small.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            path, optimize=True
        )


def main() -> None:
    """All figures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        data = fleets(folder)
        chosen_chargers(data)
        difference(data)
        one_dock(folder)
        plan_checked(data)
    for path in FIGURES.glob("plant_*.png"):
        shrink(path)


if __name__ == "__main__":
    main()
