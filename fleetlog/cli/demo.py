"""``fleetlog demo``: the whole job on sample data, as the commands that a person would type."""

from __future__ import annotations

import contextlib
import shlex
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import click

from fleetlog.cli.options import anywhere, overwrite_option


def sample_folder() -> Path:
    """The sample data: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "sample_data"
    return inside if inside.is_dir() else package.parent / "sample_data"


def steps(sample: Path, out: Path) -> list[tuple[str, list[str]]]:
    """What is done, in words and as a command line."""
    site, truck, recorded = str(sample / "site.toml"), str(sample / "truck.toml"), str(out / "recorded")
    logs = sorted(str(p) for p in (sample / "logs").iterdir())
    again = [
        "simulate",
        "--site",
        site,
        "--truck",
        truck,
        "--like",
        recorded,
        "--same-mission",
        "--seed",
        "1",
    ]
    model = ["--physics", str(out / "diagnosis" / "model.toml")]
    return [
        (
            "Logs of eight trucks in five formats become one dataset",
            ["import", *logs, "--site", site, "-o", recorded],
        ),
        ("Where it is tight", ["analyze", "density", recorded, "-o", str(out / "density")]),
        ("Where chargers belong", ["analyze", "chargers", recorded, "-k", "2", "-o", str(out / "chargers")]),
        (
            "A fleet of the same kind, simulated",
            [
                *("simulate", "--site", site, "--truck", truck, "--vehicles", "8", "--duration", "30m"),
                *("--like", recorded, "--seed", "1", "-o", str(out / "simulated")),
            ],
        ),
        (
            "What physics was left out?",
            ["diagnose", recorded, "--truck", truck, "-o", str(out / "diagnosis")],
        ),
        ("The recorded trips again, with what was found", [*again, *model, "-o", str(out / "resimulated")]),
        (
            "Is the mismatch gone?",
            [
                "diagnose",
                recorded,
                "--truck",
                truck,
                "--against",
                str(out / "resimulated"),
                "-o",
                str(out / "after"),
            ],
        ),
    ]


@click.command()
@click.option(
    "-o",
    "--output",
    type=anywhere,
    default=Path("fleetlog-demo"),
    show_default=True,
    help="Folder for everything that is made.",
)
@overwrite_option
def command(output: Path, overwrite: bool) -> None:
    """Import, simulate, analyze and diagnose half an hour of a sample plant;
    needs no network and no screen.
    """
    from fleetlog.cli.main import cli
    from fleetlog.errors import EXIT_DAMAGED
    from fleetlog.store.output import atomic_output

    with atomic_output(output, "demo", overwrite=overwrite) as scratch, contextlib.chdir(scratch):
        for number, (what, arguments) in enumerate(steps(sample_folder(), Path()), start=1):
            shown = shlex.join(arguments).replace(str(sample_folder()), "SAMPLE")
            click.secho(f"\n{number}. {what}", bold=True)
            click.echo(f"$ fleetlog {shown}")
            with redirect_stdout(StringIO()) as said:
                status = cli.main(arguments, standalone_mode=False)
            click.echo(said.getvalue().replace(str(scratch), str(output)), nl=False)
            if status not in (None, 0, EXIT_DAMAGED):
                raise click.exceptions.Exit(int(status))
    click.secho("\nWhere to look", bold=True)
    for path, what in (
        ("recorded", "the replay: fleetlog view"),
        ("simulated", "the simulated fleet: fleetlog view"),
        ("diagnosis/report.html", "what was left out, for a person: a browser"),
        ("density/density.png", "where trucks crowd: a picture"),
    ):
        click.echo(f"  {output / path!s:40s} {what}")
