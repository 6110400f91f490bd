"""What many runs cost in memory, and that a second start finds its compiled programs."""

import os
import stat
import subprocess
import sys

import jax
import pytest

import jaxstage as js
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.runtime import toolchain
from jaxstage.simulate import tiles
from jaxstage.system import files, runtime

MEMORY = """
import resource, sys
import jax, numpy as np
import jaxstage as js
js.configure("double", cores=2, cache=sys.argv[1])
from jaxstage.simulate.batch import BatchSpec, _rollouts, _Spreading, rollouts
from jaxstage.metrics import standard
lanes, random = int(sys.argv[2]), np.random.default_rng(0)
spread = lambda x: np.asarray(x) * random.uniform(0.8, 1.2, (lanes, *np.shape(x)))
nothing = lambda tree: jax.tree.map(lambda _: None, tree)

def prepared(seconds):
    c = js.build("dfcmac-circle", js.Timing(lap_time=seconds, laps=1, dt=1e-3))
    c = js.with_metric(c, standard(lambda memory: memory.surface))
    gains = js.replace(c.gains, slope=spread(c.gains.slope), rate=0.01 * spread(c.gains.rate))
    scenario = js.replace(c.scenario, plant=jax.tree.map(spread, c.scenario.plant))
    scenario = js.replace(
        scenario, plant=js.replace(scenario.plant, static=scenario.plant.coulomb * 1.5)
    )
    axes = js.replace(nothing(c.gains), slope=0, rate=0)
    plants = js.replace(nothing(c.scenario), plant=jax.tree.map(lambda _: 0, c.scenario.plant))
    return c.loop, c.window.ticks, (gains, scenario, c.path), (axes, plants, nothing(c.path))

for seconds in map(float, sys.argv[3:]):
    loop, ticks, inputs, axes = prepared(seconds)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    run = rollouts(loop, *inputs, ticks, in_axes=(*axes[:2], None), tile=128)
    jax.block_until_ready(run)
    assert run.report["tracking"].ate.shape == (lanes,)
    risen = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    leaves, structure = jax.tree.flatten(inputs)
    batched = tuple(x is not None for x in jax.tree.leaves(axes, is_leaf=lambda x: x is None))
    leaves = [jax.numpy.asarray(x) for x in leaves]
    spec, spreading = BatchSpec(loop, ticks, structure, batched), _Spreading(128, 2, False)
    compiled = _rollouts.lower(spec, spreading, leaves).compile()
    memory = compiled.memory_analysis()
    print(risen, memory.temp_size_in_bytes + memory.output_size_in_bytes)
"""

CACHE = """
import sys, logging
import jax
import jaxstage as js
js.configure("double", cache=sys.argv[1])
hits = []
from jax import monitoring
monitoring.register_event_listener(lambda name, **_: hits.append(name))
js.build("pi-circle", js.Timing(lap_time=0.1, laps=1)).simulate()
print(sum(name.endswith("cache_hits") for name in hits))
"""


def child(program, *arguments):
    found = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        check=True, capture_output=True, text=True,
        env={**os.environ, "TF_CPP_MIN_LOG_LEVEL": "3"},
    )  # fmt: skip
    return [float(word) for word in found.stdout.split()]


def test_memory_of_ten_thousand_runs_does_not_grow_with_their_length(tmp_path):
    """10 000 runs, all default metrics: at most 512 MB more, compilation included; what the
    program itself needs is the same for ten times the ticks within 5 %."""
    found = child(MEMORY, tmp_path, 10_000, 0.05, 0.5)
    short, short_program, more, long_program = found
    assert short < 512e6 and short + more < 512e6
    assert long_program < 1.05 * short_program


@pytest.mark.fast
def test_a_second_start_finds_its_compiled_programs(tmp_path):
    assert child(CACHE, tmp_path) == [0]
    assert child(CACHE, tmp_path)[0] >= 1


def test_a_full_disk_is_a_scan_with_its_reason(monkeypatch):
    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(toolchain.os, "replace", full)
    with pytest.raises(LoweringError, match=r"cannot be written: .*No space left"):
        toolchain.build('// a text of its own\n#define REAL double\n#include "simd.h"\n')


def test_a_new_cache_is_private(tmp_path, monkeypatch):
    monkeypatch.setattr(jax.config, "update", lambda *a: None)
    js.configure(cache=tmp_path / "above" / "cache")
    assert stat.S_IMODE((tmp_path / "above" / "cache").stat().st_mode) == 0o700


def test_a_cache_of_somebody_else_is_not_used(tmp_path, monkeypatch):
    owner = os.geteuid()
    before = runtime.cache_folder()
    monkeypatch.setattr(files.os, "geteuid", lambda: owner + 1)
    with pytest.warns(UserWarning, match=f"programs: {tmp_path}: it belongs to user {owner}"):
        js.configure(cache=tmp_path)
    assert runtime.cache_folder() == before


@pytest.mark.parametrize("text", ["", "null", "[]", '{"a": "64", "b": 64.0, "c": 65}', "[" * 10**5])
def test_damaged_tiles_are_measured_again(tmp_path, monkeypatch, text):
    (tmp_path / "tiles.json").write_text(text, encoding="utf-8")
    monkeypatch.setattr(tiles, "cache_folder", lambda: str(tmp_path))
    assert tiles._read() == {}
    tiles._write({"a": 64})
    assert tiles._read() == {"a": 64}
