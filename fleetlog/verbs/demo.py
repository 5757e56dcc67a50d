"""Run the whole workflow on sample data."""

import contextlib
import shlex
import shutil
import tomllib
from pathlib import Path
from typing import Any

import fleetlog
from fleetlog.api.answer import Answer
from fleetlog.api.inputs import PathLike, as_path
from fleetlog.api.verb import verb
from fleetlog.listening import notice
from fleetlog.store.output import atomic_output

DEMO = tomllib.loads(Path(__file__).with_name("demo.toml").read_text(encoding="utf-8"))


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
        target = as_path(data)
        scripts = shutil.ignore_patterns("*.py", "__pycache__")
        with atomic_output(target, "sample data", overwrite=overwrite) as scratch:
            shutil.copytree(sample_folder(), scratch, dirs_exist_ok=True, ignore=scripts)
        names = sorted(p.name for p in target.iterdir() if not p.name.startswith("."))
        summary = {"output": str(target), "files": names}
        return Answer("demo", summary, lines=[", ".join(names)], output=target, kind="sample data")
    target = as_path(output)
    with atomic_output(target, "demo", overwrite=overwrite) as scratch, contextlib.chdir(scratch):
        for number, step in enumerate(DEMO["step"], start=1):
            for line in ("", f"{number}. {step['what']}", f"$ fleetlog {command_line(step)}"):
                notice(line)
            given, options = map(here, step["given"]), {k: here(v) for k, v in step["options"].items()}
            verb_, _, analysis = step["command"].replace("import", "import_").partition(" ")
            for line in getattr(getattr(fleetlog, verb_), analysis or "__call__")(*given, **options).lines:
                notice(line)
    notice("")
    lines = ["Where to look", *(f"  {target / path!s:40s} {what}" for path, what in DEMO["where"].items())]
    return Answer("demo", {"output": str(target)}, lines=lines, output=target, kind="demo")


def here(value: Any) -> Any:
    """An argument of a step, with the folder of the sample data in place of SAMPLE."""
    return value.replace("SAMPLE", str(sample_folder())) if isinstance(value, str) else value


def command_line(step: dict[str, Any]) -> str:
    """What a person would type, with SAMPLE for the folder of the sample data."""
    words = [*step["command"].split(), *step["given"]]
    for option, value in step["options"].items():
        spelled = "o" if option == "output" else option.replace("_", "-")
        words.append(f"{'-' if len(spelled) == 1 else '--'}{spelled}")
        words += [] if value is True else [str(value)]
    return shlex.join(words)
