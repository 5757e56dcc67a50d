"""Any number of workers, a cluster, and a worker that is killed in the middle: the same bytes."""

import json
import os
import signal
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest

from fleetlog import engines
from fleetlog.analysis.chargers import chargers
from fleetlog.analysis.density import density
from fleetlog.analysis.energy import energy
from fleetlog.analysis.heatmap import heatmap
from fleetlog.analysis.stops import stops
from fleetlog.analysis.trips import trips
from fleetlog.engines import processes
from fleetlog.ingest.pipeline import import_logs
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.results import write_result


def diagnosed(fleet, truck, folder):
    """The document of a diagnosis and its tables."""
    from fleetlog.discovery.diagnose import diagnose
    from fleetlog.discovery.report.output import write_diagnosis

    folder.mkdir(parents=True)
    write_diagnosis(diagnose(fleet, truck.with_value("resistance.rolling", 0.01)), folder)
    return files(folder)


ANALYSES = {
    "energy": lambda d, truck: energy(d, truck),
    "heatmap": lambda d, truck: heatmap(d, by="hour"),
    "density": lambda d, truck: density(d, step=0.5),
    "stops": lambda d, truck: stops(d),
    "chargers": lambda d, truck: chargers(d, k=2),
    "trips": lambda d, truck: trips(d),
}


def files(folder: Path) -> dict[str, bytes]:
    """Every file of an output by its name; where a dataset says how it was made, the command is left out."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def analysed(name, fleet, truck, folder):
    folder.mkdir(parents=True)
    write_result(ANALYSES[name](fleet, truck), folder, fleet.site.frame)
    return files(folder)


def imported(logs, site, folder):
    with DatasetWriter.create(folder, "recorded", site) as writer:
        summary = import_logs([logs], site, writer)
    assert summary.rejected and not (folder / ".spill").exists()
    return files(folder)


@pytest.fixture(scope="module")
def alone(tmp_path_factory, fleet, truck, logs, site):
    """What one process makes."""
    folder = tmp_path_factory.mktemp("alone")
    made = {name: analysed(name, fleet, truck, folder / name) for name in ANALYSES}
    return {**made, "import": imported(logs, site, folder / "import")}


@contextmanager
def murder(monkeypatch, tmp_path):
    """Kill the first worker that begins its second job; say whether it happened."""
    attempt, marker, mine = processes.attempt, tmp_path / "killed", os.getpid()
    done = []

    def deadly(work, job, name):
        if os.getpid() != mine:
            done.append(job)
            if len(done) == 2 and not marker.exists():
                marker.touch()
                os.kill(os.getpid(), signal.SIGKILL)
        return attempt(work, job, name)

    monkeypatch.setattr(processes, "attempt", deadly)
    yield
    assert marker.exists()


@pytest.mark.parametrize("workers", [2, 4])
@pytest.mark.parametrize("name", [*ANALYSES, "import"])
def test_workers(name, workers, alone, fleet, truck, logs, site, tmp_path):
    with engines.using(workers):
        made = make(name, fleet, truck, logs, site, tmp_path / "out")
    assert made == alone[name]


@pytest.mark.parametrize("name", ["energy", "heatmap", "density", "import"])
def test_a_worker_killed_in_the_middle(name, alone, fleet, truck, logs, site, tmp_path, monkeypatch):
    with murder(monkeypatch, tmp_path), engines.using(2):
        made = make(name, fleet, truck, logs, site, tmp_path / "out")
    assert made == alone[name]


def make(name, fleet, truck, logs, site, folder):
    return imported(logs, site, folder) if name == "import" else analysed(name, fleet, truck, folder)


@pytest.fixture(scope="module")
def scheduler():
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.parametrize("name", ["energy", "heatmap", "density", "import"])
def test_a_cluster_by_its_address(name, alone, fleet, truck, logs, site, tmp_path, scheduler):
    with engines.using(scheduler=scheduler):
        made = make(name, fleet, truck, logs, site, tmp_path / "out")
    assert made == alone[name]


@pytest.mark.parametrize("name", ["energy", "import"])
def test_workers_in_another_folder(
    name, alone, fleet, truck, logs, site, tmp_path, scheduler, monkeypatch
):  # fmt: skip
    """Names are relative to the folder of who asks, not to those of the workers."""
    monkeypatch.chdir(tmp_path)
    near = Dataset(os.path.relpath(fleet.path)), Path(os.path.relpath(logs))
    with engines.using(scheduler=scheduler):
        made = make(name, near[0], truck, near[1], site, Path("out"))
    assert made == alone[name]


@pytest.mark.parametrize("name", ["energy", "heatmap", "density", "import"])
def test_a_worker_of_the_cluster_killed_in_the_middle(
    name, alone, fleet, truck, logs, site, tmp_path, scheduler, monkeypatch
):
    from distributed import Future

    outcome, killed = Future.result, []

    def deadly(self, timeout=None):
        result = outcome(self, timeout)
        if not killed:
            killed.extend(self.client.run(os.getpid).values())
            os.kill(min(killed), signal.SIGKILL)
        return result

    monkeypatch.setattr(Future, "result", deadly)
    with engines.using(scheduler=scheduler):
        made = make(name, fleet, truck, logs, site, tmp_path / "out")
    assert killed and made == alone[name]


@pytest.fixture(scope="module")
def diagnosed_alone(tmp_path_factory, fleet, truck):
    return diagnosed(fleet, truck, tmp_path_factory.mktemp("diagnosis") / "out")


@pytest.mark.parametrize("how", ["two", "killed", "cluster"])
def test_diagnose(how, diagnosed_alone, fleet, truck, tmp_path, monkeypatch, request):
    address = request.getfixturevalue("scheduler") if how == "cluster" else None
    crime = murder(monkeypatch, tmp_path) if how == "killed" else nullcontext()
    with crime, engines.using(None if address else 2, address):
        assert diagnosed(fleet, truck, tmp_path / "out") == diagnosed_alone


def test_the_command_that_made_a_dataset_names_no_engine(monkeypatch):
    from fleetlog.store.documents import provenance

    told = []
    for more in ([], ["--workers", "4"], ["--workers=2"], ["--scheduler", "tcp://a:1"]):
        monkeypatch.setattr("sys.argv", ["fleetlog", "import", *more, "x.csv", "-o", "out"])
        told.append(json.dumps(provenance()))
    assert len(set(told)) == 1 and "import x.csv -o out" in told[0]
