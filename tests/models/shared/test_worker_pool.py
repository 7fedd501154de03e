"""Worker pool: its results arrive, and an interrupt ends its processes at once."""

import multiprocessing
import os
import signal
import subprocess
import sys

import pytest

from firmware_py.core.console import Terminated
from firmware_py.core.errors import InputError
from models.shared.worker_pool import worker_pool


@pytest.mark.parametrize("error", [KeyboardInterrupt, Terminated])
def test_workers_return_results_and_end_with_the_command(error):
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with pytest.raises(error), worker_pool(1) as pool:
            assert pool.submit(divmod, 7, 2).result() == (3, 1)
            job = pool.submit(signal.pause)  # it never ends
            workers = multiprocessing.active_children()
            assert workers
            if error is not Terminated:
                raise error
            signal.raise_signal(signal.SIGTERM)
            job.result()
    finally:
        signal.signal(signal.SIGTERM, before)
    for worker in workers:
        worker.join()
        # The exit code may be missing here: the pool's thread may have asked for it first.
        with pytest.raises(ProcessLookupError):
            os.kill(worker.pid, 0)


def test_a_killed_worker_is_one_sentence_that_names_memory_and_the_option():
    with (
        pytest.raises(InputError, match=r"--workers 1: .*memory"),
        worker_pool(1) as pool,
    ):
        pool.submit(os._exit, 9).result()


def test_workers_end_with_a_command_that_is_killed():
    script = (
        "import signal\n"
        "from models.shared.worker_pool import worker_pool\n"
        "with worker_pool(1) as pool:\n"
        "    pool.submit(abs, -1).result()\n"
        "    job = pool.submit(signal.pause)\n"
        "    print('busy', flush=True)\n"
        "    job.result()\n"
    )
    command = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert command.stdout.readline() == "busy\n"
    command.kill()
    # The pipe closes when the last process that holds it, a worker, has ended.
    assert command.communicate(timeout=60) == ("", None)
