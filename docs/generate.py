"""Write the reference pages that are made from code: columns, tables, commands, physics terms, truck keys.

python docs/generate.py            write them
python docs/generate.py --check    exit 1 when one is not fresh
"""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path

import click

from fleetlog.cli.main import cli, verb_lines
from fleetlog.core.columns import COLUMNS
from fleetlog.core.truck import SECTIONS
from fleetlog.physics.power import all_terms
from fleetlog.store.events import ACTIVITIES, TABLES, WAYS
from fleetlog.verbs.analyze import analyze

HERE = Path(__file__).parent / "reference"
MADE = "<!-- made by docs/generate.py -->\n\n"


def columns() -> str:
    """The trajectory columns."""
    kinds = {"time": "timestamp[us, UTC]", "label": "string (dictionary)"}
    rows = [f"| `{c.name}` | {kinds.get(c.kind, c.kind)} | {c.unit} | {c.meaning} |" for c in COLUMNS]
    head = "# The columns of a trajectory\n\nUnknown is null, never zero. "
    head += "Any further column of a log is kept under its own name.\n\n"
    return (
        MADE
        + head
        + "| column | type | unit | meaning |\n| --- | --- | --- | --- |\n"
        + "\n".join(rows)
        + "\n"
    )


def tables() -> str:
    """The tables beside the trajectories of a simulated dataset."""
    kinds = {"time": "timestamp[us, UTC]", "label": "string", "line": "list of double"}
    out = [
        MADE + "# The tables beside a simulation\n\nParquet files in the folder of a simulated dataset, "
        "named with their rows under `tables` in `dataset.json`. "
        "An imported dataset has none. Unknown is null.\n"
    ]
    for name, columns in TABLES.items():
        out.append(f"\n## {name}.parquet\n\n| column | type | unit | meaning |\n| --- | --- | --- | --- |")
        out += [f"| `{c.name}` | {kinds.get(c.kind, c.kind)} | {c.unit} | {c.meaning} |" for c in columns]
    for title, words in (("The activities", ACTIVITIES), ("The kinds of ways", WAYS)):
        out += [f"\n## {title}\n", *(f"- `{word}`: {meaning}" for word, meaning in words.items())]
    return "\n".join(out) + "\n"


def truck() -> str:
    """The keys of a truck file."""
    out = [MADE + "# The keys of a truck file\n\nAll but `chassis.mass` have a default.\n"]
    for section, kind in SECTIONS.items():
        out.append(
            f"\n## [{section}]\n\n{(kind.__doc__ or '').strip()}\n\n| key | default | unit | meaning |\n| "
            "--- | --- | --- | --- |"
        )
        for f in fields(kind):
            default = "" if f.default is f.default_factory else f"{f.default:g}"
            default = default if isinstance(f.default, float) else ""
            out.append(f"| `{f.name}` | {default} | {f.metadata['unit']} | {f.metadata['meaning']} |")
    return "\n".join(out) + "\n"


def terms() -> str:
    """The physics terms."""
    out = [
        MADE + "# Physics terms\n\nThe terms stand in `fleetlog/physics/terms/terms.toml`, their formulas in "
        "`fleetlog/physics/formulas.py`. A term of your own is one file; see [Extend fleetlog](../extend.md).\n"
    ]
    for name, term in sorted(all_terms().items()):
        law = " ".join((term.function.__doc__ or "").split()) if term.function else term.law
        out.append(f"\n## {name}\n\nMissing: {term.statement}.\n\n{law}\n")
        out += [f"- `{p.name}` [{p.unit}], plausible {p.low:g} to {p.high:g}" for p in term.parameters]
    return "\n".join(out) + "\n"


def commands() -> str:
    """Every command with its help."""
    out = [MADE + "# Commands\n"]

    def walk(command: click.Command, path: tuple[str, ...]) -> None:
        ctx = click.Context(
            command,
            info_name=" ".join(path),
            max_content_width=100,
            terminal_width=100,
            **cli.context_settings,
        )
        out.append(f"\n## {' '.join(path)}\n\n```\n{command.get_help(ctx)}\n```")
        if isinstance(command, click.Group):
            for name in command.list_commands(ctx):
                child = command.get_command(ctx, name)
                if child is not None:
                    walk(child, (*path, name))

    walk(cli, ("fleetlog",))
    return "\n".join(out) + "\n"


def python() -> str:
    """The functions of the library, as directives of mkdocstrings."""
    out = [MADE + (HERE / "_python_head.md").read_text(encoding="utf-8") + "\n## Functions\n"]
    for name in verb_lines():
        if name == "analyze":
            continue
        own = "import_" if name == "import" else name
        shown = "read_logs" if name == "import" else name
        out.append(
            f'::: fleetlog.verbs.{own}.{own}\n    options: {{heading: "{shown}", toc_label: "{shown}"}}'
        )
    out.append(
        "\n## Analyses\n\nEach is `fleetlog.analyze.NAME(dataset, ...)`; all of them "
        "take `output` and `overwrite` too.\n"
    )
    out += [f"::: fleetlog.analysis.{name}.{name}" for name in analyze.lines()]
    return "\n".join(out) + "\n\n" + (HERE / "_python_tail.md").read_text(encoding="utf-8")


def main() -> None:
    """Write or check."""
    stale = []
    HERE.mkdir(exist_ok=True)
    for make in (columns, tables, truck, terms, commands, python):
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
