"""The chunks of a sweep, in order: computed here, by threads, processes, or a Dask cluster.

Machine code lets threads share the processor; motions one by one, and reading scenes again, do not:
these go to processes.  Only so many chunks are under way at a time that memory does not grow
with their number.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from robodyn.dynamics.dynamics import RobodynWarning
from robodyn.errors import InputError, RobodynError
from robodyn.sweeps.sweep_chunks import Rows, run_chunk
from robodyn.sweeps.sweep_plan import Plan

MANY_SCENES = 1000  # from so many on reading them is what takes the time
AHEAD = 2  # chunks under way for each worker
PATIENCE = 60.0  # s without a worker of the cluster
POLL = 1.0  # s between looks whether there is one
ANSWER = 5.0  # s in which a scheduler must answer
CONNECT = 10.0  # s in which it must greet
_ENVIRONMENT = threading.Lock()  # held by the thread that changes it


def results(
    plan: Plan,
    begin: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    patience: float = PATIENCE,
    tell: Callable[[str], object] = lambda text: None,
) -> Generator[Rows]:
    """The rows of the chunks from `begin` on, in order.

    `workers` is the number of threads or processes (None: one a processor), `scheduler` the address
    of a Dask scheduler that takes their place.  Raises RobodynError where a worker is lost, or, of
    a cluster, where all are and none comes for `patience` seconds, which `tell` is told of.
    """
    left = plan.chunks - begin
    if scheduler is not None:
        with _cluster(scheduler, patience, tell) as (submit, width):
            yield from _ordered(submit, plan, begin, AHEAD * width)
        return
    count = min(processors() if workers is None else workers, left)
    if count <= 1:
        for number in range(begin, plan.chunks):
            yield run_chunk(plan, number)
        return
    before = set(multiprocessing.active_children())
    with _starting_processes():
        executor = _executor(plan, count)
    try:

        def submit(*work: Any) -> Any:
            with _starting_processes():
                return executor.submit(*work)

        yield from _ordered(submit, plan, begin, AHEAD * count)
    except BrokenProcessPool:
        raise RobodynError("a worker process ended", limit="was it out of memory?") from None
    except BaseException:  # what is under way is of no use any more
        executor.shutdown(wait=False, cancel_futures=True)  # a result cut off would never arrive
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise
    finally:
        executor.shutdown(wait=isinstance(executor, ProcessPoolExecutor), cancel_futures=True)


@contextmanager
def without_remarks() -> Iterator[None]:
    """Leave out the warnings of single motions in this process: rows have a remark for all."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobodynWarning)
        yield


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _ordered(submit: Callable[..., Any], plan: Plan, begin: int, ahead: int) -> Iterator[Rows]:
    waiting: deque[Any] = deque()
    for number in range(begin, plan.chunks):
        waiting.append(submit(run_chunk, plan, number))
        if len(waiting) >= ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def _executor(plan: Plan, count: int) -> Executor:
    scenes = 1
    for k in plan.scene_axes:
        values = plan.variation.axes[k].values
        scenes *= len(values) if values else plan.variation.size
    compiled = plan.method == "taylor" and plan.kind == "motion"
    safe = sys.flags.safe_path or not sys.flags.ignore_environment  # see `_starting_processes`
    if (compiled and scenes < MANY_SCENES) or not safe:
        return ThreadPoolExecutor(count)
    return ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin_worker)


@contextmanager
def _starting_processes() -> Iterator[None]:
    """Start processes that import nothing from the working directory and do not hear Ctrl-C.

    `python -c`, by which workers and the resource tracker begin, searches that directory first
    unless PYTHONSAFEPATH is set.  Ctrl-C is handled by the parent after a process has begun.
    """
    with _ENVIRONMENT:
        before = os.environ.get("PYTHONSAFEPATH")
        os.environ["PYTHONSAFEPATH"] = "1"
        try:
            with _interrupts_held():
                yield
        finally:
            if before is None:
                del os.environ["PYTHONSAFEPATH"]
            else:
                os.environ["PYTHONSAFEPATH"] = before


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back until the block ends; processes begun in it ignore SIGINT."""
    here = threading.current_thread() is threading.main_thread()
    if not (here and hasattr(signal, "pthread_sigmask")):
        yield
        return
    heard: list[int] = []
    ends = (signal.SIGINT, signal.SIGTERM)
    handlers = [signal.signal(number, lambda k, _: heard.append(k)) for number in ends]
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in zip(ends, handlers, strict=True):
            signal.signal(number, handler)
        if heard:
            signal.raise_signal(heard[0])


def _begin_worker() -> None:
    """A worker ends with its parent, however that ends; where it can hear Ctrl-C it does not.

    Warnings of its motions stay with it, see `without_remarks`.
    """
    warnings.simplefilter("ignore", RobodynWarning)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _cluster(
    address: str, patience: float, tell: Callable[[str], object]
) -> Iterator[tuple[Callable[..., Any], int]]:
    """A function that submits to the cluster, and how many chunks it computes at once."""
    try:
        import distributed
    except ImportError:
        limit = "needs the extra `cluster` (pip install '.[cluster]')"
        raise InputError("scheduler", value=address, limit=limit) from None
    for name in ("distributed", "distributed.client", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what fails is told by an error
    gc.collect()  # one that found no scheduler, and ended while the next begins, would wait for it
    connect: Any = distributed.Client
    try:
        _greet(address, min(CONNECT, max(patience, POLL)))
        client: Any = connect(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        limit = f"no Dask scheduler answers there: {str(error) or 'timed out'}"
        raise RobodynError("scheduler", value=address, limit=limit) from None
    try:
        watch = _Watch(client, address, patience, tell)
        threads = watch.threads()
        if not threads:
            raise RobodynError("scheduler", value=address, limit="it has no workers")

        def submit(function: Callable[..., Rows], *arguments: Any) -> Any:
            return _Remote(client.submit(function, *arguments, pure=False), watch)

        yield submit, threads
    finally:
        client.close()


def _greet(address: str, seconds: float) -> None:
    """Raise OSError if what is at `address` does not greet as Dask does within so many seconds.

    A client would wait without end for one that accepts and stays silent.
    """
    import distributed

    dask: Any = distributed
    secured = dask.Security().get_connection_args("client")

    async def greeted() -> None:
        comm = await dask.core.connect(address, seconds, **secured)
        await comm.close()

    runner = dask.utils.LoopRunner()
    runner.start()
    try:
        dask.utils.sync(runner.loop, greeted, callback_timeout=seconds)
    finally:
        runner.stop()


class _Watch:
    """Looks whether a cluster that lets wait has workers; after so long without one it is lost."""

    def __init__(
        self, client: Any, address: str, patience: float, tell: Callable[[str], object]
    ) -> None:
        self._client, self._address = client, address
        self._patience, self._tell = patience, tell
        self.lost: float | None = None  # since when

    def threads(self) -> int:
        """Return the number of threads of its workers; 0 if the scheduler does not answer."""
        answer = min(ANSWER, max(self._patience, POLL))
        try:
            found = self._client.sync(self._client.scheduler.ncores, callback_timeout=answer)
        except (TimeoutError, OSError):
            return 0
        return sum(found.values())

    def look(self) -> None:
        """Raise RobodynError where patience is at its end."""
        asked = time.monotonic()
        if self.threads():
            if self.lost is not None:
                self._tell("the cluster has workers again")
            self.lost = None
            return
        if self.lost is None:
            self.lost = asked
            wait = f"waiting {self._patience:g} s for another (patience)"
            self._tell(f"the cluster has lost all its workers: {wait}")
        if time.monotonic() - self.lost >= self._patience:
            limit = f"all its workers are lost, and none came within {self._patience:g} s"
            raise RobodynError("scheduler", value=self._address, limit=limit)


class _Remote:
    """A future of the cluster, whose failures are told as errors of robodyn."""

    def __init__(self, future: Any, watch: _Watch) -> None:
        self._future, self._watch = future, watch

    def result(self) -> Any:
        try:
            while True:
                try:
                    found = self._future.result(timeout=POLL)
                except TimeoutError:
                    if self._future.status == "error":  # the chunk's own, or it came just now
                        return self._future.result()
                    self._watch.look()
                else:
                    self._watch.lost = None
                    return found
        except RobodynError:
            raise
        except CancelledError:
            limit = "it ended, or the way to it did"
            raise RobodynError("the scheduler was lost", limit=limit) from None
        except ModuleNotFoundError as error:
            limit = f"a worker has no module {error.name}: install there what is installed here"
            raise RobodynError("scheduler", limit=limit) from None
        except Exception as error:
            kind = type(error).__name__
            raise RobodynError("scheduler", limit=f"the cluster failed: {kind}: {error}") from error
