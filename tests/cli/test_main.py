"""The command line as a whole: quick to answer, every verb documented, errors in one line with the right status."""

import subprocess
import sys

import click
import pytest

from fleetlog.cli.main import cli, verb_lines


def run(*args, **more):
    return subprocess.run(
        [sys.executable, "-m", "fleetlog", *args], capture_output=True, text=True, check=False, **more
    )


def test_help_imports_nothing_heavy():
    code = "import sys; from fleetlog.cli.main import cli; cli(['--help'], standalone_mode=False); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = set(out.split())
    assert not loaded & {
        "numpy",
        "pyarrow",
        "pandas",
        "rerun",
        "scipy",
        "numba",
        "pyproj",
        "networkx",
        "matplotlib",
    }


def walk(command, path=()):
    yield path, command
    if isinstance(command, click.Group):
        ctx = click.Context(command)
        for name in command.list_commands(ctx):
            yield from walk(command.get_command(ctx, name), (*path, name))


def test_every_command_and_option_is_explained():
    for path, command in walk(cli):
        assert command.help, path
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                assert parameter.help, (path, parameter.name)


def test_group_help_and_verbs_agree():
    for name, line in verb_lines().items():
        command = cli.get_command(click.Context(cli), name)
        assert command is not None and line.endswith(".")


@pytest.mark.parametrize("args", [("analyse",), ("import",), ("info", "no-such-thing")])
def test_wrong_usage_is_status_2_or_1_in_few_lines(args):
    done = run(*args)
    assert done.returncode in (1, 2) and "Traceback" not in done.stderr and done.stderr.strip()


def test_version():
    import fleetlog

    assert run("-V").stdout.strip() == f"fleetlog {fleetlog.__version__}"
