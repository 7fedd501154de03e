"""Worker pool: its results arrive, and an interrupt ends its processes at once."""

import multiprocessing
import os
import signal

import pytest

from models.shared.worker_pool import worker_pool


def test_results_arrive():
    with worker_pool(1) as pool:
        assert pool.submit(divmod, 7, 2).result() == (3, 1)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_workers_end_with_the_command(error):
    with pytest.raises(error), worker_pool(1) as pool:
        assert pool.submit(abs, -1).result() == 1
        pool.submit(signal.pause)  # a job that never ends
        workers = multiprocessing.active_children()
        assert workers
        raise error
    for worker in workers:
        worker.join()
        # The exit code may be missing here: the pool's own thread may have asked for it first.
        with pytest.raises(ProcessLookupError):
            os.kill(worker.pid, 0)
