"""Single against double precision: the stored table, the refusal, the doctor; the processor."""

import json
import sys
from types import SimpleNamespace

import jax
import pytest

import jaxstage as js
from jaxstage.metrics import contour, energy, together, tracking, windowed
from jaxstage.studies import all_studies
from jaxstage.studies.precision import HEADLINE, LARGEST, compare_precision, stored_precision, worst
from jaxstage.system.runtime import processor
from tuning.app import main as cli
from tuning.store.prepare import refuse_rough


@pytest.mark.fast
def test_every_loop_has_a_row():
    for study in all_studies:
        table = stored_precision(study.name)
        assert set(table) == {entry.name for entry in study.loops}
        axis = {key for key in HEADLINE if not key.startswith("contour")}
        assert all(set(row) in (set(HEADLINE), axis) for row in table.values())


@pytest.mark.parametrize("name", ["dfcmac-bowknot", "cascade-heart"])
def test_the_table_holds_what_is_measured(name):
    """Rounding differs between machines: the side of the limit is the same, the size similar."""
    stored = stored_precision("fuzzy-cmac")[name]
    case = js.build(name)
    headline = together(tracking, contour, energy)
    judged = windowed(headline, case.window.start, case.window.stop, "scored")
    measured = compare_precision(js.with_metric(case, judged))
    assert (worst(measured)[1] > LARGEST) == (worst(stored)[1] > LARGEST)
    assert worst(measured)[1] == pytest.approx(worst(stored)[1], rel=0.9)


def test_comparing_needs_double(single):
    with pytest.raises(ValueError, match="needs precision = double"):
        compare_precision(js.build("pi-circle", js.Timing(lap_time=0.01, laps=1)))


def test_python_is_warned_where_the_command_line_refuses(single):
    short = js.Timing(lap_time=0.01, laps=1)
    with pytest.warns(UserWarning, match="single precision moves ate_um of cascade-heart by 3"):
        js.build("cascade-heart", short)


def call(monkeypatch, *words):
    kept = {n: getattr(jax.config, n) for n in ("jax_enable_x64", "jax_compilation_cache_dir")}
    monkeypatch.setattr(sys, "argv", ["jaxstage", *words])
    try:
        with pytest.raises(SystemExit) as end:
            cli.main()
    finally:
        for name, value in kept.items():
            jax.config.update(name, value)
    return end.value.code


@pytest.mark.parametrize(("measured", "refused"), [(0.02, True), (0.005, False)])
def test_the_guard_measures_at_the_timing_asked_for(monkeypatch, measured, refused):
    """pi-circle is fine at its own timing, which is stored; at another one it is measured."""
    asked = []

    def compared(case):
        asked.append(case.timing)
        assert case.scenario.plant.mass.dtype == "float64"
        return {"ate_um": measured, "energy_J": 0.0}

    monkeypatch.setattr("jaxstage.studies.precision.compare_precision", compared)
    refuse_rough("pi-circle", [])
    assert asked == [], "what is stored is not measured again"
    if refused:
        with pytest.raises(ValueError, match=r"ate_um of pi-circle is off by 2\.0%"):
            refuse_rough("pi-circle", ["lap_time=0.5"])
    else:
        refuse_rough("pi-circle", ["lap_time=0.5"])
    assert [timing.lap_time for timing in asked] == [0.5]


def test_a_rough_loop_is_refused_unless_forced(monkeypatch, capsys):
    single = ("--precision", "single", "--json")
    assert call(monkeypatch, "run", "cascade-heart", *single) == 2
    refused = capsys.readouterr()
    assert refused.out == "" and "ate_um of cascade-heart is off by 3" in refused.err
    short = (*single, "--set", "lap_time=0.05", "--set", "laps=1", "--force")
    assert call(monkeypatch, "run", "cascade-heart", *short) in (0, None)
    assert json.loads(capsys.readouterr().out)["precision"] == "single"


def test_the_doctor(monkeypatch, capsys):
    monkeypatch.setattr(
        "jaxstage.system.runtime.cpu_cores", lambda: None
    )  # JAX has already started
    assert call(monkeypatch, "doctor", "--json") in (0, None)
    found = json.loads(capsys.readouterr().out)
    assert found["jax"] == jax.__version__ and found["precision"] == "double"
    assert found["lane_steps_per_s"] > 1e3 and len(found["devices"]) >= 1


@pytest.mark.fast
@pytest.mark.parametrize(
    ("told", "name"),
    [
        ("processor\t: 0\nmodel name\t: Some Core @ 2 GHz\nflags : a\n", "Some Core @ 2 GHz"),
        ("processor\t: 0\nCPU part\t: 0xd0c\n", "an-architecture"),
        ("model name\t:\n", "an-architecture"),
    ],
)
def test_a_processor_without_a_model_is_named_by_its_architecture(monkeypatch, told, name):
    file = SimpleNamespace(read_text=lambda encoding: told)
    monkeypatch.setattr("jaxstage.system.runtime.Path", {"/proc/cpuinfo": file}.__getitem__)
    monkeypatch.setattr("platform.processor", lambda: "")
    monkeypatch.setattr("platform.machine", lambda: "an-architecture")
    assert processor() == name
