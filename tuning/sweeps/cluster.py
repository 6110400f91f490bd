"""Executors on many processes or machines, by Dask distributed (an extra)."""

import logging
import sys
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager

_MISSING = "--workers and --scheduler need Dask: pip install 'jaxstage[cluster]'"


@contextmanager
def local_workers(count: int) -> Iterator[Executor]:
    """Worker processes on this machine, started anew when one dies; nobody else reaches them.
    Raises ValueError for < 1."""
    if count < 1:
        raise ValueError(f"--workers {count}: must be >= 1")
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError(_MISSING) from None
    with (
        LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=0,
            silence_logs=50,
        ) as cluster,
        Client(cluster) as client,
        _told(),
    ):
        yield client.get_executor()


@contextmanager
def scheduler_at(address: str, timeout: float = 10.0) -> Iterator[Executor]:
    """The workers of a running Dask scheduler. Raises OSError where none answers."""
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(_MISSING) from None
    try:
        client = Client(address, timeout=timeout)
    except (OSError, ValueError) as error:
        raise OSError(f"--scheduler {address}: {error}") from None
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # `_told` says it
    with client, _told():
        if not client.nthreads():
            print(f"jaxstage: {address} has no workers yet: waiting for them", file=sys.stderr)
        yield client.get_executor()


@contextmanager
def _told() -> Iterator[None]:
    """A scheduler that is gone, or a chunk whose workers die again and again, in one line."""
    from distributed import KilledWorker

    try:
        yield
    except CancelledError:
        raise OSError("the scheduler is gone: finished chunks are kept, --resume goes on") from None
    except KilledWorker as error:
        raise OSError(
            f"{error.allowed_failures + 1} workers died on one chunk (out of memory?): finished "
            "chunks are kept, --resume goes on"
        ) from None
