"""``jaxstage frequency``: margins, bandwidth and stiffness of a loop."""

import csv
import io
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tuning.app.shared_options import AsJson, GainsFile, Loop, ScenarioFile, Settings

if TYPE_CHECKING:
    from jaxstage.frequency import FrequencyView

#: rows of the table: key of an axis, what it is, unit
ROWS = (
    ("gm_up_db", "gain margin up", "dB"),
    ("gm_up_Hz", "  at", "Hz"),
    ("gm_down_db", "gain margin down", "dB"),
    ("gm_down_Hz", "  at", "Hz"),
    ("pm_deg", "phase margin", "deg"),
    ("pm_Hz", "  at", "Hz"),
    ("delay_margin_us", "delay margin", "us"),
    ("ms", "Ms, largest |S|", ""),
    ("ms_Hz", "  at", "Hz"),
    ("mt", "Mt, largest |T|", ""),
    ("bandwidth_Hz", "bandwidth with feed-forward", "Hz"),
    ("bandwidth_feedback_Hz", "bandwidth of the position command", "Hz"),
    ("stiffness_min_N_um", "lowest dynamic stiffness", "N/um"),
    ("stiffness_Hz", "  at", "Hz"),
)


@dataclass(frozen=True)
class FrequencyOptions:
    """What ``jaxstage frequency`` takes."""

    loop: Loop
    at: Annotated[
        str | None,
        typer.Option(
            metavar="SPEED[,SPEED...]",
            help="Speed of every axis at the operating point in m/s, or one each; 0: standstill. "
            "Left out: mean feed of the loop over sqrt(axes).",
        ),
    ] = None
    axis: Annotated[str | None, typer.Option(help="Sine sweep of this axis only.")] = None
    cut: Annotated[
        str, typer.Option(help="Where the loop is opened: input (of the plant), or position.")
    ] = "input"
    low: Annotated[float | None, typer.Option("--from", help="Lowest frequency in Hz.")] = None
    high: Annotated[float | None, typer.Option("--to", help="Highest frequency in Hz.")] = None
    sine: Annotated[
        str | None,
        typer.Option(
            metavar="AMPLITUDE[,AMPLITUDE...]",
            help="Sine sweep of the full loop, too: amplitudes in the unit of the command.",
        ),
    ] = None
    words: Settings = field(default_factory=list)
    gains: GainsFile = None
    scenario: ScenarioFile = None
    as_json: AsJson = False
    out: Annotated[
        Path | None, typer.Option(help="Folder for bode.png, nyquist.png, response.csv, ...")
    ] = None


def frequency(options: FrequencyOptions) -> None:
    """Margins, bandwidth, stiffness; Bode and Nyquist plots."""
    from jaxstage.system.runtime import configure
    from tuning.app.messages import print_json, warn
    from tuning.store.gains_file import read_gains
    from tuning.store.prepare import check_folder, prepare
    from tuning.uncertainty.scenario_file import read_scenario

    speeds, amplitudes = numbers("--at", options.at), numbers("--sine", options.sine)
    configure(precision="double", cache="default")
    from jaxstage.frequency import answer, view, with_sines

    gains, scenario = read_gains(options.gains), read_scenario(options.scenario)
    prepared = prepare(options.loop, options.words, gains, scenario)
    names = prepared.case.loop.plant.axes
    if options.axis is not None and options.axis not in names:
        raise ValueError(f"--axis {options.axis}: must be one of {', '.join(names)}")
    if options.out is not None:
        check_folder(options.out)
    seen = view(prepared.case, speeds, options.cut, band=(options.low, options.high))  # type: ignore[arg-type]
    if amplitudes:
        seen = with_sines(seen, amplitudes, (options.axis,) if options.axis else None)
    result = answer(seen, prepared.notes)
    for note in result["notes"]:
        warn(note)
    if options.out is not None:
        _write(seen, result, options.out)
    if options.as_json:
        print_json(result)
        return
    _show(result)
    if options.out is not None:
        files = "bode.png, nyquist.png, sensitivity.png, frequency.json, response.csv"
        print(f"{files}: {options.out}/")


def numbers(option: str, text: str | None) -> list[float] | None:
    """The numbers of a list with commas.

    Raises:
        ValueError: for what is no number, naming the option.
    """
    if text is None:
        return None
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise ValueError(f"{option} {text}: must be numbers with commas") from None


def _show(result: dict[str, Any]) -> None:
    """Print the margins of all axes, and the sine sweep."""
    from tuning.app.result_table import Column, ResultTable, numeric, say, show

    speeds = ", ".join(f"{name} {v:g} m/s" for name, v in result["at_m_s"].items())
    say(f"{result['loop']} at {speeds}, cut at the {result['cut']}", "bold")
    steady = "steady" if result["steady"] else "not steady"
    say(f"spectral radius {result['spectral_radius']:.6f}, {steady}")
    axes = result["axes"]
    rows = [
        {"margin": label, "unit": unit} | {name: axis[key] for name, axis in axes.items()}
        for key, label, unit in ROWS
        if not label.startswith(" ") or any(axis[key] is not None for axis in axes.values())
    ]
    columns = (Column("margin"), *(numeric(name, name) for name in axes), Column("unit", "unit"))
    show(ResultTable(columns, rows))
    if len(axes) > 1 and result["coupled"]["ms"] is not None:
        coupled = result["coupled"]
        say(f"all axes together: Ms {coupled['ms']:.4g} at {coupled['ms_Hz']:.4g} Hz")
    if result["sine"]:
        sines = (
            Column("axis", "sine at axis"),
            numeric("amplitude", "amplitude"),
            numeric("f_Hz", "Hz"),
            numeric("s", "|S| of the full loop"),
            numeric("s_linear", "|S| linear"),
            numeric("harmonics", "harmonics"),
        )
        show(ResultTable(sines, result["sine"]))


def _write(seen: "FrequencyView", result: dict[str, Any], out: Path) -> None:
    from jaxstage.plot.frequency import frequency_plots
    from jaxstage.system.files import write_text

    out.mkdir(parents=True, exist_ok=True)
    frequency_plots(seen, out)
    write_text(out / "frequency.json", json.dumps(result, indent=2, allow_nan=False))
    write_text(out / "response.csv", _table(seen))


def _table(seen: "FrequencyView") -> str:
    """f_Hz, then real and imaginary part of L, S, T, G and compliance of each axis."""
    from jaxstage.frequency import compliance, sensitivity, tracking

    s, g, flexible = sensitivity(seen.model), tracking(seen.model), compliance(seen.model)
    columns: dict[str, Any] = {"f_Hz": seen.omega / (2 * math.pi)}
    for i, name in enumerate(seen.axes):
        one = s(seen.omega)[:, i, i]
        parts = {
            "L": 1 / one - 1,
            "S": one,
            "T": 1 - one,
            "G": g(seen.omega)[:, i, i],
            "compliance_m_N": flexible(seen.omega)[:, i, i],
        }
        for what, values in parts.items():
            columns |= {f"{what}_{name}_re": values.real, f"{what}_{name}_im": values.imag}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(map(float, column) for column in columns.values()), strict=True))
    return text.getvalue()
