"""The engine: every item comes back once, whatever ends its workers."""

import pytest
from engine_works import deadly, squares, wrong

from isetval import InputError
from isetval.core.engine import Here, Lost, Processes, chunks, run_works


@pytest.fixture
def two():
    engine = Processes(2)
    yield engine
    engine.close()


def test_chunks():
    assert list(chunks(range(5), 2)) == [[0, 1], [2, 3], [4]]
    assert list(chunks([], 2)) == []


def test_every_item_once_here_and_in_processes(two):
    for engine in (Here(), two):
        found = [square for _, result in run_works(squares, chunks(range(50), 4), engine) for square in result]
        assert sorted(found) == [i * i for i in range(50)]


def test_bounded_in_flight():
    taken = []

    def works():
        for i in range(100):
            taken.append(i)
            yield [i]

    results = run_works(squares, works(), Here(), in_flight=3)
    next(results)
    assert len(taken) == 3


def test_the_one_item_that_ends_its_worker_is_found_and_no_other_is_lost(two):
    """13 is alone in flight after 2 halvings, ends two workers more, and is given up; the other 15 come back once."""
    found, lost = [], []
    for items, result in run_works(deadly, chunks(range(8, 24), 4), two):
        if isinstance(result, Lost):
            lost += items
        else:
            found += result
    assert lost == [13]
    assert sorted(found) == [i for i in range(8, 24) if i != 13]


def test_an_error_of_the_work_is_raised(two):
    for engine in (Here(), two):
        with pytest.raises(ZeroDivisionError):
            list(run_works(wrong, [[1]], engine))


def test_no_process_at_all():
    with pytest.raises(InputError, match="jobs is 0; it needs at least 1"):
        Processes(0)
