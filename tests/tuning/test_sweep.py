"""Sweeps: the same numbers however they are cut, stopped, resumed or replayed."""

import errno
import multiprocessing
import os
import random
import shutil
import signal
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor
from pathlib import Path

import distributed
import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tomli_w

from jaxstage.system.runtime import processor
from tests.helpers.sweeping import REQUEST, sweep_in, table, text
from tuning.store.work_folder import digest
from tuning.sweeps import replays, store
from tuning.sweeps.analysis import Question, analyse
from tuning.sweeps.cluster import _told, local_workers, scheduler_at
from tuning.sweeps.configuration import build, drawn_values
from tuning.sweeps.replays import RunSelection
from tuning.sweeps.summary import as_object
from tuning.sweeps.sweep import sweep
from tuning.uncertainty.metric_table import parameter_columns
from tuning.uncertainty.uncertain_space import study_spreads


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Compiled programs, shared with the processes that are started."""
    before = jax.config.jax_compilation_cache_dir
    folder = str(tmp_path_factory.mktemp("cache") / "jaxstage")
    jax.config.update("jax_compilation_cache_dir", folder)
    yield folder
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, cache):
    """The folder of the undisturbed sweep."""
    folder = tmp_path_factory.mktemp("sweeps") / "whole"
    store.create(folder, text(), resume=False)
    assert sweep(text(), folder) == REQUEST.runs
    return folder


@pytest.fixture(scope="module")
def processes(cache):
    """Start a process that sweeps: it can be killed at any moment."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tuning.sweeps.sweep", "sweeping"])

    def start(folder, configuration, cores=1):
        arguments = (str(folder), configuration, cache, cores)
        process = context.Process(target=sweep_in, args=arguments)
        process.start()
        return process

    return start


def files(folder):
    return sorted((folder / store.RUNS).glob("*/*.parquet"))


# --- what a row holds ------------------------------------------------------------------------


def test_a_row_is_a_run_with_units_in_its_columns(whole):
    rows = table(whole)
    assert rows.num_rows == REQUEST.runs
    assert rows["run"].to_pylist() == list(range(REQUEST.runs))
    names = rows.column_names
    for name in ("plant_mass_x_kg", "plant_damping_y_Ns_per_m", "contour_max_um", "finite"):
        assert name in names
    mass = rows["plant_mass_x_kg"].to_numpy()
    assert len(set(mass)) == REQUEST.runs and (0.8 * 3e-3 <= mass).all() and (mass <= 3.6e-3).all()
    metadata = pq.read_schema(files(whole)[0]).metadata
    assert metadata[b"configuration"].decode() == text()
    assert metadata[b"configuration_sha256"].decode() == digest(text())
    for key in (b"jax", b"jaxstage", b"seed", b"devices"):
        assert metadata[key]
    assert metadata[b"processor"].decode() == processor()
    (case, *_) = build(text()).cases
    window, dt = case.window, case.loop.dt
    assert float(metadata[b"scored_laps"]) == window.scored_laps == 1.0
    assert float(metadata[b"scored_from_s"]) == window.start * dt
    assert float(metadata[b"scored_to_s"]) == window.stop * dt


def test_a_row_is_what_a_single_run_gives(whole):
    rows, plan = table(whole).to_pylist(), build(text())
    for run in (0, REQUEST.runs - 1):
        case = replays.machine(plan, 0, run)
        report = case.simulate().report
        assert rows[run]["contour_max_um"] == pytest.approx(
            float(report["contour"].contour_max) * 1e6, rel=1e-9
        )
        assert rows[run]["following_rms_y_um"] == pytest.approx(
            float(report["following"].following_rms[1]) * 1e6, rel=1e-9
        )
        assert rows[run]["plant_mass_y_kg"] == float(case.scenario.plant.mass[1])


def test_lost_runs_are_kept_with_their_tick(tmp_path):
    """A motor two hundred times as strong makes the loop unstable."""
    strong = {
        "path": "plant.force_constant", "distribution": "discrete", "values": [1.0, 200.0],
        "shared": True,
    }  # fmt: skip
    others = [s for s in study_spreads("pi-circle") if s["path"] != strong["path"]]
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(tomli_w.dumps({"spread": [strong, *others]}))
    lost, folder = text(scenario=scenario), tmp_path / "out"
    store.create(folder, lost, resume=False)
    sweep(lost, folder)
    rows = table(folder).to_pylist()
    unstable = [row["plant_force_constant_x_N_per_A"] > 100 for row in rows]
    assert 0 < sum(unstable) < len(rows)
    for row, is_lost in zip(rows, unstable, strict=True):
        assert row["finite"] is not is_lost
        if is_lost:
            assert row["contour_max_um"] is None and row["left_path_at"] > 0
            assert row["lost_at_s"] == pytest.approx(row["left_path_at"] * 1e-4)
        else:
            assert row["contour_max_um"] > 0 and row["left_path_at"] is None
    plan = build(lost)
    ((loop, worst),) = replays.select_runs(folder, plan, RunSelection(worst=sum(unstable)))
    assert sorted(worst) == [r["run"] for r, bad in zip(rows, unstable, strict=True) if bad]
    assert all(row["identical"] for row in replays.replay(folder, plan, loop, worst[:3]))


# --- the same table however it is computed ---------------------------------------------------


@pytest.mark.parametrize("chunk", [3, 5])
def test_the_chunk_changes_nothing_but_the_files(whole, tmp_path, chunk):
    other = text(chunk=chunk)
    store.create(tmp_path / "out", other, resume=False)
    with ThreadPoolExecutor(2) as executor:
        sweep(other, tmp_path / "out", executor)
    assert len(files(tmp_path / "out")) == -(-REQUEST.runs // chunk)
    assert table(tmp_path / "out").equals(table(whole))


def test_killed_at_any_moment_nothing_is_lost_or_doubled(whole, tmp_path, processes):
    """SIGKILL somewhere after the first, second, ... finished chunk; then it runs to its end."""
    folder, chunks = tmp_path / "out", len(files(whole))
    for least in (1, 3):
        process = processes(folder, text())
        while len(files(folder)) < least and process.is_alive():
            time.sleep(0.005)
        time.sleep(random.uniform(0, 0.05))
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL, "it had come to its end"
    done = {file: (file.stat().st_mtime_ns, file.read_bytes()) for file in files(folder)}
    assert 3 <= len(done)
    last = processes(folder, text())
    last.join()
    assert last.exitcode == 0 and len(files(folder)) == chunks
    for file, (written, content) in done.items():
        assert file.stat().st_mtime_ns == written and file.read_bytes() == content
    assert table(folder).equals(table(whole))
    assert not list(folder.rglob("*.partial"))


def test_a_killed_worker_costs_only_its_chunk(whole, tmp_path, cache, monkeypatch):
    """One of two Dask workers is killed in mid-sweep."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(Path(cache).parent))
    folder, killed = tmp_path / "out", []
    store.create(folder, text(), resume=False)

    def kill_once(progress):
        if not killed:
            workers = distributed.get_client().run(os.getpid)
            killed.append(next(iter(workers.values())))
            os.kill(killed[0], signal.SIGKILL)

    with local_workers(2) as executor:
        assert sweep(text(), folder, executor, kill_once, cores=1) == REQUEST.runs
    assert killed
    assert table(folder).equals(table(whole))


def test_workers_listen_to_this_machine_alone():
    with local_workers(1):
        client = distributed.get_client()
        host = client.cluster.scheduler.address
        assert host.startswith("tcp://127.0.0.1:")
        assert all(w.startswith("tcp://127.0.0.1:") for w in client.scheduler_info()["workers"])
        assert "127.0.0.1" in client.dashboard_link


def test_no_scheduler_is_one_line():
    nobody = scheduler_at("tcp://127.0.0.1:9", timeout=0.5)
    with pytest.raises(OSError, match=r"--scheduler tcp://127\.0\.0\.1:9: "), nobody:
        raise AssertionError
    with pytest.raises(OSError, match="scheduler is gone: finished chunks are kept"), _told():
        raise CancelledError
    with pytest.raises(ValueError, match="--workers 0: must be >= 1"), local_workers(0):
        raise AssertionError


def test_two_devices_give_the_same_within_rounding(whole, tmp_path, processes):
    """XLA compiles the partitioned program on its own: the last bits may differ, < 1e-10.

    The residual of the energy ledger is nothing but rounding: 1e-16 J.
    """
    process = processes(tmp_path / "out", text(), cores=2)
    process.join()
    assert process.exitcode == 0
    found, wanted = table(tmp_path / "out"), table(whole)
    assert found.column_names == wanted.column_names
    for name in wanted.column_names:
        if pa.types.is_floating(wanted[name].type):
            pair = (found[name].to_numpy(), wanted[name].to_numpy())
            np.testing.assert_allclose(*pair, rtol=1e-10, atol=1e-15, err_msg=name)
        else:
            assert found[name].to_pylist() == wanted[name].to_pylist()
    metadata = pq.read_schema(files(tmp_path / "out")[0]).metadata
    assert metadata[b"devices"] == b"2"


def test_single_precision_is_a_configuration_of_its_own(whole, tmp_path):
    single = text(precision="single")
    store.create(tmp_path / "out", single, resume=False)
    sweep(single, tmp_path / "out")
    found, wanted = (table(f)["contour_max_um"].to_numpy() for f in (tmp_path / "out", whole))
    assert (found != wanted).all()
    np.testing.assert_allclose(found, wanted, rtol=1e-2)
    assert (found == found.astype(np.float32).astype(float)).sum() < len(found)  # um, not m
    with pytest.raises(ValueError, match="precision: double -> single"):
        store.create(whole, single, resume=True)


# --- folders ---------------------------------------------------------------------------------


def test_a_chunk_that_is_not_whole_is_computed_again(whole, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(whole, folder)
    cut, foreign, gone = files(folder)[1], files(folder)[2], files(folder)[4]
    cut.write_bytes(cut.read_bytes()[:-200])
    rows = pq.read_table(foreign)
    pq.write_table(rows.replace_schema_metadata({"configuration_sha256": "other"}), foreign)
    gone.unlink()
    assert store.missing(folder, build(text())) == [1, 2, 4]
    store.create(folder, text(), resume=True)
    assert sweep(text(), folder) == 9
    assert table(folder).equals(table(whole))


def test_a_flipped_bit_is_never_a_number(whole, tmp_path):
    """Wherever a bit of a chunk flips, it is missing and computed again."""
    folder, source = tmp_path / "out", random.Random(5)
    shutil.copytree(whole, folder)
    file, plan, spoilt = files(folder)[1], build(text()), 0
    written = file.read_bytes()
    for _ in range(150):
        flipped = bytearray(written)
        flipped[source.randrange(len(written))] ^= 1 << source.randrange(8)
        file.write_bytes(flipped)
        spoilt += store.missing(folder, plan) == [1]
    assert spoilt == 150
    assert sweep(text(), folder) == 3
    assert table(folder).equals(table(whole))


@pytest.mark.parametrize("name", [".sweep.toml.0123456789ab.partial", "sweep.toml.partial"])
@pytest.mark.parametrize("resume", [False, True])
def test_a_kill_before_the_configuration_blocks_nothing(tmp_path, name, resume):
    (tmp_path / name).write_text("jaxst")
    store.create(tmp_path, text(), resume)
    assert store.read_configuration(tmp_path) == text()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("runs = 18", 'runs = "18"'),
        ("runs = 18", "runs = -1"),
        ("runs = 18", "runs = true"),
        ('design = "sobol"', 'design = ["sobol"]'),
        ('design = "sobol"', 'design = "soool"'),
        ("[[loop]]", "[loop]"),
        ("[loop.timing]", "[loop.tining]"),
        ("[loop.values]", "[[loop.values]]"),
        ("seed = 0", "seed = []"),
        ('path = "plant.mass"', "path = 3"),
    ],
)
def test_a_damaged_configuration_is_one_line(old, new):
    assert old in text()
    with pytest.raises(ValueError) as error:
        build(text().replace(old, new))
    assert "\n" not in str(error.value)


def test_a_full_disk_keeps_what_was_finished(whole, tmp_path, monkeypatch):
    folder, replace = tmp_path / "out", os.replace
    store.create(folder, text(), resume=False)

    def full(source, target):
        if len(files(folder)) == 2:
            raise OSError(errno.ENOSPC, "No space left on device", str(source))
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left"):
        sweep(text(), folder)
    monkeypatch.undo()
    assert len(files(folder)) == 2 and not list(folder.rglob("*.partial"))
    assert sweep(text(), folder) == REQUEST.runs - 6
    assert table(folder).equals(table(whole))


def test_a_folder_is_never_overwritten(whole, tmp_path):
    with pytest.raises(ValueError, match="holds this sweep already: --resume goes on"):
        store.create(whole, text(), resume=False)
    changed = text(seed=1)
    with pytest.raises(ValueError, match=r"another configuration; seed: 0 -> 1$"):
        store.create(whole, changed, resume=True)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("mine")
    for resume in (False, True):
        with pytest.raises(ValueError, match="holds no sweep"):
            store.create(foreign, text(), resume=resume)
    assert [file.name for file in foreign.iterdir()] == ["thesis.txt"]
    with pytest.raises(ValueError, match="does not exist"):
        store.create(tmp_path / "none", text(), resume=True)
    with store.locked(whole), pytest.raises(ValueError, match="another process is sweeping"):
        sweep(text(), whole)


def test_another_version_refuses_to_go_on(whole):
    with pytest.raises(ValueError, match=r"configured with jax 0\.0\.1, here is"):
        build(text().replace(f'jax = "{jax.__version__}"', 'jax = "0.0.1"'))


# --- what is said of it ---------------------------------------------------------------------------


def test_what_cannot_be_said_does_not_cost_the_rest(tmp_path):
    """A Saltelli design with lost runs: few are left out, many leave no index, never no answer."""
    runs = 14 * 64  # twelve uncertain values
    configuration = text(design="saltelli", runs=runs, chunk=runs)
    plan = build(configuration)
    drawn = parameter_columns(plan.spaces[0].uncertain, drawn_values(plan, 0, 0, runs))
    for lost, says in ((1, "leave out 1.6% of the blocks"), (7, "there are no Sobol indices")):
        figure = 1e3 * drawn["plant_mass_x_kg"]
        figure[: 14 * lost : 14] = np.nan
        rows = pa.table({
            "loop": ["pi-circle"] * runs, "run": np.arange(runs), **drawn,
            "contour_max_um": pa.array(figure, mask=np.isnan(figure)),
            "finite": np.isfinite(figure), "lost_at_s": np.where(np.isnan(figure), 0.1, np.nan),
        }).replace_schema_metadata({"configuration_sha256": digest(configuration)})  # fmt: skip
        folder = tmp_path / str(lost)
        store.create(folder, configuration, resume=False)
        store.write(folder, plan, 0, rows)
        found = analyse(folder, plan, Question(spec="contour_max_um < 3"))
        (loop,) = found.loops
        assert (loop.indices is not None) == (lost == 1)
        assert loop.met.of == 64 and loop.met.count == np.sum(figure[::14] < 3)
        assert any(says in note and note.startswith("pi-circle: ") for note in found.notes)
        drawn_again = as_object(found, folder)
        assert (drawn_again["loops"][0]["sobol_indices"] is not None) == (lost == 1)
    assert loop.correlations["plant_mass_x_kg"] > 0.9


# --- replay ----------------------------------------------------------------------------------


def test_a_replayed_run_gives_its_row_back_exactly(whole):
    plan, rows = build(text()), table(whole).to_pylist()
    for runs in ([0], [17, 4, 9]):
        found = replays.replay(whole, plan, 0, runs)
        assert [row["run"] for row in found] == runs
        for row in found:
            stored = rows[row["run"]]
            assert row["identical"] is True and row["largest_difference"] == 0
            for name, value in (row["parameters"] | row["figures"]).items():
                assert stored[name] == value, name
    with pytest.raises(ValueError, match=r"--run 18: must be 0\.\.17"):
        replays.replay(whole, plan, 0, [18])


def test_the_worst_runs_are_the_worst(whole):
    values = table(whole)["contour_max_um"].to_numpy()
    ((loop, runs),) = replays.select_runs(
        whole, build(text()), RunSelection(worst=3, metric="contour_max_um")
    )
    assert loop == 0 and runs == list(np.argsort(-values)[:3])


def test_a_changed_row_is_noticed(whole, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(whole, folder)
    file = files(folder)[0]
    rows = pq.read_table(file)
    place = rows.column_names.index("contour_max_um")
    wrong = rows.set_column(place, "contour_max_um", pa.array([1.0, 2.0, 3.0]))
    store.write(folder, build(text()), 0, wrong)
    (row,) = replays.replay(folder, build(text()), 0, [1])
    assert row["identical"] is False and row["largest_difference"] > 0.1
