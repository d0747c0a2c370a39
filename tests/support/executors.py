"""Executors that train units in this process, some of them as a pool elsewhere would."""

import pickle
from concurrent.futures import Executor, Future

from curricle.comparison import plan
from curricle.study import run_study


class Inline(Executor):
    """Trains a unit when it is submitted; after so many it takes none."""

    def __init__(self, most=10**9):
        self.left, self.trained = most, 0

    def submit(self, function, work):
        if not self.left:
            raise OSError("the cluster is gone")
        self.left -= 1
        future = Future()
        try:
            future.set_result(self.result(function, work))
            self.trained += 1
        except Exception as error:
            future.set_exception(error)
        return future

    def result(self, function, work):
        return function(work)


class Elsewhere(Inline):
    """Workers that get copies, as those on other machines do, and send copies back."""

    def result(self, function, work):
        try:
            return through(function(through(work)))
        except Exception as error:
            raise through(error) from None


def through(value):
    return pickle.loads(pickle.dumps(value))


class Held(Executor):
    """Holds what is submitted; each time its workers are counted, their number may change."""

    def __init__(self, numbers, *, last_first=False):
        self.numbers, self.held, self.most, self.submitted = list(numbers), [], [], []
        self.place = -1 if last_first else 0

    def submit(self, function, argument):
        self.held.append((Future(), function, argument))
        self.submitted.append(argument)
        return self.held[-1][0]

    def count(self):
        if len(self.numbers) > 1:
            return self.numbers.pop(0)
        return self.numbers[0]

    def wait(self, futures, timeout, return_when):
        """Return nothing while the number of workers changes, else what is trained next."""
        self.most.append(len(futures))
        if not futures:
            return set(), set()
        if len(self.numbers) > 1:
            return set(), set(futures)
        future, function, argument = self.held.pop(self.place)
        future.set_result(function(argument))
        return {future}, set()


def sent_units(pool, monkeypatch, study, out, **settings):
    """Run a study on a pool that holds what is submitted."""
    with monkeypatch.context() as patch:
        patch.setattr(plan, "wait", pool.wait)
        return run_study(study, out, executor=pool, workers=pool.count, **settings)
