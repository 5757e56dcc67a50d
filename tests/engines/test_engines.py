"""Jobs on one core, on several, and on a cluster: same results in the same order, whatever dies on the way."""

import errno
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from fleetlog import engines
from fleetlog.api.verb import JOBS as ADDED
from fleetlog.api.verb import Verb
from fleetlog.engines.processes import Processes
from fleetlog.errors import ArgumentError, DataError, InputError

JOBS = list(range(23))


def slow_square(number):
    time.sleep(0.01 * (number % 3 == 0))  # results arrive out of order
    return number * number


def failing(folder, number):
    if number in (3, 5):
        raise InputError("damaged", where=f"file-{number}", do="make it again")
    (folder / str(number)).touch()
    return number


def deadly(folder, number):
    """Kills its own process the first time; always, where it is number 4."""
    try:
        (folder / f"{number}").touch(exist_ok=number == 4)
    except FileExistsError:
        return number
    if number in (2, 4):
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_results_come_in_the_order_of_the_jobs(workers):
    with engines.using(workers) as engine:
        assert list(engine.run(slow_square, JOBS)) == [n * n for n in JOBS]


@pytest.mark.parametrize("workers", [1, 3])
def test_a_job_that_fails_is_named_and_leaves_the_rest(tmp_path, workers):
    done = []
    with engines.using(workers) as engine, pytest.raises(InputError, match="file-3") as caught:
        for result in engine.run(partial(failing, tmp_path), JOBS):
            done.append(result)
    assert done == [0, 1, 2] and "1 more failed" in caught.value.line()
    assert len(list(tmp_path.iterdir())) == len(JOBS) - 2


def test_a_fault_names_what_it_read():
    with engines.using(2) as engine, pytest.raises(DataError, match=r"part 0.*slow square.*TypeError"):
        list(engine.run(slow_square, [None, 1], lambda job: "part 0"))


def test_a_killed_worker_is_replaced_and_its_job_done_again(tmp_path):
    jobs = [0, 1, 2, 3]
    with engines.using(2) as engine:
        assert list(engine.run(partial(deadly, tmp_path), jobs)) == jobs


def test_a_job_that_always_kills_is_given_up_by_name(tmp_path):
    with engines.using(2) as engine, pytest.raises(DataError, match=r"job 4.*died 3 times"):
        list(engine.run(partial(deadly, tmp_path), [3, 4, 5], "job {}".format))


def test_nobody_is_left_when_results_are_not_wanted():
    before = _children()  # a server or a tracker that an earlier test started
    results = Processes(3, always=True).run(slow_square, JOBS)
    assert next(results) == 0
    children = _children() - before
    assert len(children) == 3
    results.close()
    assert not _children() & children


def _children():
    return {int(p) for p in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_beside_the_jobs_is_done_here(tmp_path, workers):
    done = []
    beside = [lambda: done.append(os.getpid()), (tmp_path / "made").touch]
    with engines.using(workers) as engine:
        pids = list(engine.run(lambda _: os.getpid(), [0], beside=beside))
    assert done == [os.getpid()] and (tmp_path / "made").exists()
    assert (pids == done) == (workers == 1)


def test_runs_beside_a_busy_worker_take_the_cores_that_are_left():
    pids = set()

    def beside():
        pids.update(engines.current().run(lambda _: os.getpid(), JOBS))

    with engines.using(2) as engine:
        list(engine.run(lambda _: time.sleep(0.5), [0], beside=[beside]))
    assert pids == {os.getpid()}


def test_modules_are_loaded_while_workers_work():
    with engines.using(2) as engine:
        engine.ahead = engines.loading("colorsys")
        sys.modules.pop("colorsys", None)
        assert list(engine.run(slow_square, JOBS)) == [n * n for n in JOBS]
    assert "colorsys" in sys.modules


@pytest.mark.parametrize("workers", [1, 2])
def test_a_full_disk_is_told_as_such(workers):
    """Whoever holds the place of the output names it."""

    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with engines.using(workers) as engine, pytest.raises(OSError) as caught:
        list(engine.run(full, [1, 2]))
    assert caught.value.errno == errno.ENOSPC


def test_a_worker_starts_no_workers_of_its_own():
    with engines.using(2) as engine:
        assert list(engine.run(_inner, [1, 2])) == [[1, 4], [1, 4]]


def _inner(_):
    return list(engines.current().run(slow_square, [1, 2]))


def test_small_work_stays_here():
    assert not Processes(4).pays(0.01) and Processes(4).pays(10.0) and not Processes(1).pays(10.0)
    assert Processes(2, always=True).pays(0.0)


def test_an_address_where_nobody_is(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(engines, "TIMEOUT", 1)
    with pytest.raises(InputError, match="no Dask scheduler"), engines.using(scheduler="tcp://127.0.0.1:9"):
        pass


@pytest.mark.parametrize("text", ["foo", "foo://a:1", "tcp://a", "tcp://a:b", "tcp://:1", "", "http://a:1"])
def test_what_is_no_address_is_wrong_usage(text):
    """A client that is refused half made would say so in a traceback of its own."""
    with pytest.raises(ArgumentError, match="tcp://HOST:PORT"):
        Verb(lambda: None, added=ADDED)(scheduler=text)


@pytest.mark.parametrize("text", ["tcp://10.0.0.1:8786", "node-3:8786", "tls://a.b:1", "tcp://[::1]:8786"])
def test_an_address(text):
    assert engines.address(text) == text
