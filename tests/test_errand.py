"""How a batch travels, and what becomes of one that comes back; without a cluster."""

import pickle
import sys
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest

from simval.results import Outcome
from simval.sweep import cluster, executors, suspects
from simval.sweep.cluster import Crowd
from simval.sweep.errand import errand
from simval.sweep.executors import Batch, Queue, computed
from simval.sweep.identity import Stated, here, refusal
from simval.sweep.roster import Roster
from simval.sweep.suite import expand

cloudpickle = pytest.importorskip("cloudpickle")
distributed = pytest.importorskip("distributed")

SAME = Stated(driver=here())
OTHER = Stated(driver=replace(here(), source="0" * 64))


def nothing(cell):
    """A cell without rows, at once."""
    return Outcome(rows=())


def queue_of(count):
    content = {"geometry": list(range(1, count + 1)), "samples": 65_536}
    cells = expand("some", {"attitude": content}).cells
    return Queue(cells, range(count), 1e-3, nothing, SAME)


@pytest.fixture
def there(monkeypatch):
    """The errand as it arrives on a worker."""
    worker = SimpleNamespace(address="tcp://there")
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    return pickle.loads(cloudpickle.dumps(errand()))


def answered(there, stated, batch):
    return there(pickle.dumps(stated), pickle.dumps(batch))


def test_a_worker_of_the_same_source_computes(there):
    batch = queue_of(1).take(1)
    (done,) = answered(there, SAME, batch)
    assert done.rows == computed(batch)[0].rows == []
    assert (done.cell[0], done.cell[5]) == (0, "done")
    assert done.machine == SAME.machine


def test_the_errand_names_no_module_of_ours(monkeypatch):
    # as on a worker that has none: what was loaded is hidden, and nothing is found
    data, stated = cloudpickle.dumps(errand()), pickle.dumps(SAME)
    worker = SimpleNamespace(address="tcp://there")
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    for name in [name for name in sys.modules if name.partition(".")[0] == "simval"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "simval", None)
    answer = pickle.loads(data)(stated, b"not looked at")
    monkeypatch.undo()
    assert answer[0] == "tcp://there"
    error = refusal(answer)
    assert error.worker == "tcp://there"
    (line,) = error.lines
    assert line.startswith("it cannot load this version of simval (ModuleNotFound")


def test_a_worker_that_differs_does_not_look_at_the_batch(there):
    error = refusal(there(pickle.dumps(OTHER), b"not looked at"))
    (line,) = error.lines
    assert line.startswith("its source code is")
    assert error.worker == "tcp://there"
    assert refusal([]) is None


class Executes:
    """A client that runs tasks here, on workers that all are lost with theirs."""

    status = "running"

    def __init__(self, *addresses):
        self.addresses, self.tasks, self.answers = addresses, [], True

    def nthreads(self):
        return dict.fromkeys(self.addresses, 1)

    def get_executor(self, pure):
        return self

    def submit(self, function, *data, workers=(), **options):
        if not data:  # the roster's question
            return SimpleNamespace(
                done=lambda: True,
                status="finished",
                result=lambda timeout: here(),
                cancel=lambda: None,
            )
        future = Future()
        self.tasks.append((tuple(workers), pickle.loads(data[1]), future))
        return future


def crowd_of(client, *refused):
    crowd = Crowd(client, Roster(client, SAME, print), "tcp://here", 1.0, print)
    crowd.begin()
    for address in refused:
        crowd.roster.refuse(address, ("it differs",))
    return crowd


def test_a_batch_that_is_refused_goes_to_the_others(monkeypatch):
    client = Executes("a", "b")
    crowd, queue = crowd_of(client), queue_of(1)
    assert not crowd.roster.asked
    steps = cluster._by_cluster(crowd, queue)
    submit = client.submit

    def answering(function, *data, **options):
        future = submit(function, *data, **options)
        if data:
            first, batch = len(client.tasks) == 1, client.tasks[-1][1]
            future.set_result(("b", "boom") if first else computed(batch))
        return future

    monkeypatch.setattr(client, "submit", answering)
    ((done,),) = steps
    assert done.cell[5] == "done"
    assert [workers for workers, _, _ in client.tasks] == [(), ("a",)]
    assert crowd.roster.refused["b"] == (
        "it cannot load this version of simval (boom)",
    )


def test_a_cell_that_always_comes_back_fails_and_those_beside_it_do_not(monkeypatch):
    # each time the workers that have batches die, and others take their place
    monkeypatch.setattr("simval.sweep.roster.ASKED", 0.0)
    monkeypatch.setattr(executors, "PAUSE", 0.0)
    client = Executes("good0", "bad")
    crowd, queue = crowd_of(client, "bad"), queue_of(3)
    deadly, deaths, beside = 1, [], []
    window = crowd.window

    def dying(flying, queue):
        held = {place for batch in flying.values() for place in batch.places}
        if deadly in held:
            deaths.append(held)
            client.addresses = (f"good{len(deaths)}", "bad")
        else:
            for _, batch, future in client.tasks:
                if future in flying and not future.done():
                    beside.append(batch.places)
                    future.set_result(computed(batch))
        return window(flying, queue)

    monkeypatch.setattr(crowd, "window", dying)
    ended = [done for some in cluster._by_cluster(crowd, queue) for done in some]
    assert {done.cell[0]: done.cell[5] for done in ended} == {
        0: "done",
        1: "failed",
        2: "done",
    }
    (failed,) = [done for done in ended if done.cell[5] == "failed"]
    assert failed.cell[6].strip() == suspects.GIVEN_UP
    assert len(deaths) == suspects.RETURNS + 1
    assert deaths[-1] == {deadly}  # by itself
    assert any(held != {deadly} for held in deaths[:-1])  # before, others beside it
    assert all(
        workers == ("bad",) or "bad" not in workers for workers, _, _ in client.tasks
    )
    assert len(beside) >= 2


def test_a_cell_beside_one_that_kills_is_given_out_by_itself_before_it_fails():
    queue, kept = queue_of(2), suspects.Suspects()
    for _ in range(suspects.RETURNS):
        places = [place for _ in range(2) for place in queue.take(1).places]
        assert sorted(places) == [0, 1]
        kept.came_back(places, queue)
    assert not queue
    for place in (0, 1):  # one after the other
        assert kept.next(queue) == []
        assert queue.take(1).places == [place]
        assert not queue
    kept.came_back([0], queue)
    (done,) = kept.next(queue)
    assert (done.cell[0], done.cell[5]) == (0, "failed")
    assert not kept
    assert isinstance(queue.alone(1), Batch)


@pytest.mark.ci
def test_a_cell_that_waits_beside_a_deadly_one_is_not_failed_with_it(monkeypatch):
    # the scheduler blames all tasks that a worker had, those that waited too
    from distributed.scheduler import KilledWorker

    client = Executes("a")
    crowd, queue = crowd_of(client), queue_of(4)
    deadly, trials, last = 2, [], SimpleNamespace(address="a")
    window = crowd.window

    def dying(flying, queue):
        held = {place for batch in flying.values() for place in batch.places}
        trials.extend([held] if deadly in held else [])
        for future, batch in flying.items():
            if future.done():
                continue
            if deadly in held:
                future.set_exception(KilledWorker("cell", last, 3))
            else:
                future.set_result(computed(batch))
        return window(flying, queue)

    monkeypatch.setattr(crowd, "window", dying)
    ended = [done for some in cluster._by_cluster(crowd, queue) for done in some]
    assert sorted((done.cell[0], done.cell[5]) for done in ended) == [
        (0, "done"),
        (1, "done"),
        (2, "failed"),
        (3, "done"),
    ]
    assert {2, 3} in trials
    assert trials[-1] == {deadly}
    assert all(not workers for workers, _, _ in client.tasks)
    (failed,) = [done for done in ended if done.cell[5] == "failed"]
    assert failed.cell[6].startswith("every worker was lost: Attempted to run task")
