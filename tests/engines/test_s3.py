"""A dataset in a bucket of a real S3 server: import, append, analyze, view."""

import json
import re

import pytest
from click.testing import CliRunner

import fleetlog
from fleetlog.cli.main import cli, verb_lines
from fleetlog.exporters.base import FORMATS
from fleetlog.store import Dataset

from .test_append import days  # noqa: F401 - a fixture

pytest.importorskip("s3fs", reason="s3fs is not installed")
pytest.importorskip("upath", reason="universal-pathlib is not installed")
server = pytest.importorskip("moto.server", reason="moto[server] is not installed")


@pytest.fixture(scope="module")
def bucket():
    """The address of an empty bucket."""
    import s3fs

    running = server.ThreadedMotoServer(port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "someone")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "something")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        s3fs.S3FileSystem.clear_instance_cache()
        s3fs.S3FileSystem().mkdir("fleet")
        yield "s3://fleet"
    s3fs.S3FileSystem.clear_instance_cache()
    running.stop()


def run(*words):
    done = CliRunner().invoke(cli, [str(w) for w in words], catch_exceptions=True)
    assert done.exit_code in (0, 3), (done.output, done.exception)
    return done


def test_import_append_analyze_view(bucket, days, project_root, truck, tmp_path):  # noqa: F811
    site = project_root / "sample_data" / "site.toml"
    url, here = f"{bucket}/recorded", tmp_path / "recorded"
    for target in (url, here):
        run("import", days / "2026-03-02", "--site", site, "-o", target)
        run("import", days / "2026-03-03", "--append", "-o", target)
    one, two = Dataset(url), Dataset(here)
    told = [json.dumps({k: v for k, v in d.meta.items() if k != "provenance"}) for d in (one, two)]
    assert told[0] == told[1]
    assert [p.read_bytes() for d in one.vehicle_days for p in one.parts(*d)] == [
        p.read_bytes() for d in two.vehicle_days for p in two.parts(*d)
    ]
    for name, workers in ((url, 2), (here, 1)):
        out = tmp_path / f"energy-{workers}"
        run("analyze", "energy", name, "--truck", project_root / "sample_data" / "truck.toml",
            "--workers", workers, "-o", out)  # fmt: skip
    for table in ("energy_trips.parquet", "energy.json"):
        assert (tmp_path / "energy-1" / table).read_bytes() == (tmp_path / "energy-2" / table).read_bytes()
    from fleetlog.view.viewer import recording_of

    replay = recording_of(one.path, say=lambda _: None)
    assert replay.stat().st_size > 10_000 and replay.read_bytes()[:4] == b"RRF2"
    assert "days             2" in run("info", url).output


def test_partial_results_are_kept_in_the_bucket(bucket, monkeypatch):
    from fleetlog.analysis.stops import stops
    from fleetlog.store import days as partials

    monkeypatch.setattr(partials, "FROM_ROWS", 0)
    data = Dataset(f"{bucket}/recorded")
    first = stops(data)
    monkeypatch.setattr(Dataset, "read", None)
    assert stops(Dataset(f"{bucket}/recorded")).summary == first.summary


def test_nothing_is_replaced(bucket, days, project_root):  # noqa: F811
    for more in ([], ["--overwrite"]):
        words = ["import", str(days / "2026-03-02"), "-o", f"{bucket}/recorded", *more]
        done = CliRunner().invoke(cli, words)
        assert done.exit_code == 1 and "s3://fleet/recorded" in str(done.exception)


def test_no_such_dataset(bucket):
    done = CliRunner().invoke(cli, ["info", f"{bucket}/other"])
    assert done.exit_code == 1 and "s3://fleet/other" in str(done.exception)


TRUCK = ("--truck", "TRUCK")
QUESTIONS = {
    **{f"analyze {name}": () for name in fleetlog.analyze.lines()},
    "analyze energy": TRUCK, "analyze chargers": ("-k", "2"), "analyze heatmap": ("--compare", "DATA"),
    **{f"export --to {name}": () for name in FORMATS.names()},
    "calibrate": TRUCK, "diagnose": (*TRUCK, "--against", "DATA"), "info": None, "learn": (), "report": TRUCK,
    "simulate --like": (*TRUCK, "--duration", "1m"), "view": None,
}  # fmt: skip
"""What is asked of a dataset, and options; None where nothing is written."""


def test_every_verb_that_takes_a_dataset_is_tried():
    takes = set()
    for verb in {*verb_lines()} - {"import", "analyze"}:
        named = {getattr(o.check, "metavar", "") for o in getattr(fleetlog, verb).options}
        takes |= {verb} & ({verb} if named & {"DATASET", "MEASUREMENTS"} else set())
    assert takes == {words.split()[0] for words in QUESTIONS} - {"analyze"}


@pytest.fixture(scope="module")
def both(bucket, project_root, tmp_path_factory):
    """One simulated dataset, in the bucket and in a folder."""
    sample, names = project_root / "sample_data", (f"{bucket}/sim", tmp_path_factory.mktemp("sim") / "sim")
    for name in names:
        run("simulate", "--site", sample / "site.toml", "--truck", sample / "truck.toml", "--vehicles", 2,
            "--duration", "3m", "--seed", 1, "-o", name)  # fmt: skip
    return names


@pytest.mark.parametrize("words", QUESTIONS)
def test_a_url_is_answered_as_a_folder_is(words, both, project_root, tmp_path):
    told = []
    for number, name in enumerate(both):
        out, more = tmp_path / f"out-{number}", QUESTIONS[words]
        truck = project_root / "sample_data" / "truck.toml"
        options = [{"TRUCK": truck, "DATA": name}.get(word, word) for word in more or ()]
        options += ["-o", out] if more is not None else []
        if words == "view":
            options = ["--screenshot", f"{out}.png"]
        done = CliRunner().invoke(cli, [*words.split(), *map(str, (name, *options)), "--json"])
        said = f"{done.stdout} {done.exception}".replace(str(out), "OUT").replace(str(name), "DATA")
        assert "fault" not in said and not isinstance(done.exception, TypeError), said
        told.append((done.exit_code, re.sub(r'"(bytes|free|modified)": \d+', "", said)))
    assert told[0] == told[1]


def test_answers_are_not_written_to_a_url(bucket, both):
    for words in (["analyze", "stops"], ["export", "--to", "csv"], ["learn"]):
        done = CliRunner().invoke(cli, [*words, str(both[1]), "-o", f"{bucket}/answer"])
        assert done.exit_code == 1 and "only datasets are written to a URL" in str(done.exception)


def test_a_file_url_is_a_folder_of_this_machine(days, tmp_path):  # noqa: F811
    url = f"file://{tmp_path}/recorded"
    run("import", days / "2026-03-02", "-o", url)
    assert (tmp_path / "recorded" / "recording.rrd").is_file()
    run("analyze", "trips", url, "-o", f"file://{tmp_path}/trips")
    assert (tmp_path / "trips" / "trips.json").is_file()
    done = CliRunner().invoke(cli, ["analyze", "trips", url, "-o", str(tmp_path / "recorded" / "trips")])
    assert done.exit_code == 1 and "lies in the dataset" in str(done.exception)
