"""A result as a table in the terminal."""

from typing import Any

from rich.console import Console
from rich.table import Table

from jaxstage.metrics.table import split_key


def show(title: str, result: dict[str, Any]) -> None:
    """Print verdict and figures: per axis where they exist, scored window and whole run."""
    console = Console(highlight=False)
    console.print(f"[bold]{result['loop']}[/bold]  {title}")
    console.print(result["verdict"])
    laps = f"{result['laps']:.4g} lap{'' if result['laps'] == 1 else 's'}"
    console.print(
        f"{result['duration_s']:g} s, {laps} of {result['lap_time_s']:.4g} s, "
        f"control period {result['dt_s'] * 1e6:g} us, {result['precision']} precision"
    )
    if not result["finite"]:
        return
    table = Table(box=None, padding=(0, 2))
    table.add_column("figure")
    table.add_column("scored", justify="right")
    table.add_column("whole run", justify="right")
    table.add_column("unit")
    for key, value in result["metrics"].items():
        name, unit = split_key(key)
        whole = result["metrics_whole_run"][key]
        if isinstance(value, dict):
            for axis in value:
                table.add_row(f"{name} {axis}", _text(value[axis]), _text(whole[axis]), unit)
        else:
            table.add_row(name, _text(value), _text(whole), unit)
    console.print(table)


def _text(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4f}" if 1e-2 <= abs(value) < 1e6 or value == 0 else f"{value:.4g}"
