"""A small sweep that tests share: 2000 ticks of the PI law, eighteen plants, six chunks."""

import functools
from pathlib import Path

from tuning.sweeps import store
from tuning.sweeps.configuration import SweepRequest, build, configure_sweep
from tuning.sweeps.sweep import sweep

REQUEST = SweepRequest(
    loops=("pi-circle",), runs=18, chunk=3, words=("lap_time=0.2", "laps=1", "scored=0")
)


@functools.cache
def text(**changes):
    return configure_sweep(REQUEST._replace(**changes))


def table(folder):
    plan = build(store.read_configuration(folder))
    return store.read(folder, plan)


def sweep_in(folder, configuration, cache, cores):
    """Make or go on with a sweep; the body of a process that may be killed."""
    import jaxstage as js

    js.configure("double", cores=cores, cache=cache)
    folder = Path(folder)
    store.create(folder, configuration, resume=folder.exists())
    sweep(configuration, folder)
