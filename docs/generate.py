"""Write the reference pages that are made from code: columns, commands, physics terms, truck keys.

python docs/generate.py            write them
python docs/generate.py --check    exit 1 when one is not fresh
"""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path

import click

from fleetlog.cli.main import cli
from fleetlog.core.columns import COLUMNS
from fleetlog.core.truck import SECTIONS
from fleetlog.physics.power import all_terms

HERE = Path(__file__).parent / "reference"
MADE = "<!-- made by docs/generate.py -->\n\n"


def columns() -> str:
    """The trajectory columns."""
    kinds = {"time": "timestamp[us, UTC]", "label": "string (dictionary)"}
    rows = [f"| `{c.name}` | {kinds.get(c.kind, c.kind)} | {c.unit} | {c.meaning} |" for c in COLUMNS]
    head = "# The columns of a trajectory\n\nUnknown is null, never zero. Any further column of a log is kept under its own name.\n\n"
    return (
        MADE
        + head
        + "| column | type | unit | meaning |\n| --- | --- | --- | --- |\n"
        + "\n".join(rows)
        + "\n"
    )


def truck() -> str:
    """The keys of a truck file."""
    out = [MADE + "# The keys of a truck file\n\nAll but `chassis.mass` have a default.\n"]
    for section, kind in SECTIONS.items():
        out.append(
            f"\n## [{section}]\n\n{(kind.__doc__ or '').strip()}\n\n| key | default | unit | meaning |\n| --- | --- | --- | --- |"
        )
        for f in fields(kind):
            default = "" if f.default is f.default_factory else f"{f.default:g}"
            default = default if isinstance(f.default, float) else ""
            out.append(f"| `{f.name}` | {default} | {f.metadata['unit']} | {f.metadata['meaning']} |")
    return "\n".join(out) + "\n"


def terms() -> str:
    """The physics terms."""
    out = [
        MADE
        + "# Physics terms\n\nOne file a term in `fleetlog/physics/terms/`; a term of your own is one more file there.\n"
    ]
    for name, term in sorted(all_terms().items()):
        law = (
            " ".join((term.function.__doc__ or "").split())
            if term.function
            else "It changes a value of the truck."
        )
        out.append(f"\n## {name}\n\nMissing: {term.statement}.\n\n{law}\n")
        out += [f"- `{p.name}` [{p.unit}], plausible {p.low:g} to {p.high:g}" for p in term.parameters]
    return "\n".join(out) + "\n"


def commands() -> str:
    """Every command with its help."""
    out = [MADE + "# Commands\n"]

    def walk(command: click.Command, path: tuple[str, ...]) -> None:
        ctx = click.Context(command, info_name=" ".join(path), max_content_width=100, terminal_width=100)
        out.append(f"\n## {' '.join(path)}\n\n```\n{command.get_help(ctx)}\n```")
        if isinstance(command, click.Group):
            for name in command.list_commands(ctx):
                child = command.get_command(ctx, name)
                if child is not None:
                    walk(child, (*path, name))

    walk(cli, ("fleetlog",))
    return "\n".join(out) + "\n"


def main() -> None:
    """Write or check."""
    stale = []
    HERE.mkdir(exist_ok=True)
    for make in (columns, truck, terms, commands):
        page, text = HERE / f"{make.__name__}.md", make()
        if "--check" in sys.argv:
            if not page.is_file() or page.read_text(encoding="utf-8") != text:
                stale.append(page.name)
        else:
            page.write_text(text, encoding="utf-8")
    if stale:
        sys.exit(f"not fresh: {', '.join(stale)}; run python docs/generate.py")


if __name__ == "__main__":
    main()
