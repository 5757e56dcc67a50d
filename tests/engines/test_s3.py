"""A dataset in a bucket of a real S3 server: import, append, analyze, view."""

import json

import pytest
from click.testing import CliRunner

from fleetlog.cli.main import cli
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
