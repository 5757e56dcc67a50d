"""Run the whole workflow on sample data."""

import contextlib
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fleetlog
from fleetlog.api.answer import Answer
from fleetlog.api.inputs import PathLike, as_path
from fleetlog.api.verb import verb
from fleetlog.listening import notice
from fleetlog.store.output import atomic_output

Step = tuple[str, str, tuple[Any, ...], dict[str, Any]]
"""What is done in words, the command, its arguments and its options."""
WHERE = {
    "recorded": "the replay: fleetlog view",
    "simulated": "the simulated fleet: fleetlog view",
    "diagnosis/report.html": "which physics the model lacks: a browser",
    "density/density.png": "where trucks delay each other: a picture",
}


def sample_folder() -> Path:
    """The sample data: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "sample_data"
    return inside if inside.is_dir() else package.parent / "sample_data"


@verb()
def demo(
    *, data: PathLike | None = None, output: PathLike = "fleetlog-demo", overwrite: bool = False
) -> Answer:
    """Import, simulate, analyze and diagnose half an hour of a sample plant; needs no network and no screen.

    Parameters
    ----------
    data : only write the sample data (logs, site, truck) to this folder; the tutorials begin with them.
    output : folder for everything that is made."""
    if data is not None:
        return _data(as_path(data), overwrite)
    target = as_path(output)
    with atomic_output(target, "demo", overwrite=overwrite) as scratch, contextlib.chdir(scratch):
        for number, (what, name, given, options) in enumerate(steps(sample_folder()), start=1):
            verb_, _, analysis = name.replace("import", "import_").partition(" ")
            for line in ("", f"{number}. {what}", f"$ fleetlog {command_line(name, given, options)}"):
                notice(line)
            for line in getattr(getattr(fleetlog, verb_), analysis or "__call__")(*given, **options).lines:
                notice(line)
    notice("")
    lines = ["Where to look", *(f"  {target / path!s:40s} {what}" for path, what in WHERE.items())]
    return Answer("demo", {"output": str(target)}, lines=lines, output=target, kind="demo")


def _data(target: Path, overwrite: bool) -> Answer:
    """Write the sample data; not the scripts that made them."""
    scripts = shutil.ignore_patterns("*.py", "__pycache__")
    with atomic_output(target, "sample data", overwrite=overwrite) as scratch:
        shutil.copytree(sample_folder(), scratch, dirs_exist_ok=True, ignore=scripts)
    names = sorted(p.name for p in target.iterdir() if not p.name.startswith("."))
    summary = {"output": str(target), "files": names}
    return Answer("demo", summary, lines=[", ".join(names)], output=target, kind="sample data")


def steps(sample: Path) -> Iterator[Step]:
    """What the demo does; outputs are names in the folder that it works in."""
    site, truck = sample / "site.toml", sample / "truck.toml"
    again = {"site": site, "truck": truck, "like": "recorded", "seed": 1}
    fleet = {**again, "vehicles": 8, "duration": "30m", "output": "simulated"}
    mission = {**again, "same_mission": True, "physics": "diagnosis/model.toml", "output": "resimulated"}
    after = {"truck": truck, "against": "resimulated", "output": "after"}
    imported, recorded = {"site": site, "output": "recorded"}, ("recorded",)
    yield "Five logs of eight trucks become one dataset", "import", (sample / "logs",), imported
    yield "Where trucks delay each other", "analyze density", recorded, {"output": "density"}
    yield "Where chargers belong", "analyze chargers", recorded, {"k": 2, "output": "chargers"}
    yield "A fleet of the same kind, simulated", "simulate", (), fleet
    yield "Which physics the model lacks", "diagnose", recorded, {"truck": truck, "output": "diagnosis"}
    yield "The recorded trips again, with what was found", "simulate", (), mission
    yield "Is the mismatch gone?", "diagnose", recorded, after


def command_line(name: str, given: tuple[Any, ...], options: dict[str, Any]) -> str:
    """What a person would type, with the folder of the sample data as SAMPLE."""
    words = [*name.split(), *map(str, given)]
    for option, value in options.items():
        spelled = "o" if option == "output" else option.replace("_", "-")
        words.append(f"{'-' if len(spelled) == 1 else '--'}{spelled}")
        words += [] if value is True else [str(value)]
    return shlex.join(words).replace(str(sample_folder()), "SAMPLE")
