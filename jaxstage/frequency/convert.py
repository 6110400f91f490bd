"""The linear model for other tools: python-control and scipy.signal."""

from typing import Any

import numpy as np

from jaxstage.frequency.linear import INPUTS, OUTPUTS, LinearModel


def _names(groups: tuple[str, ...], axes: tuple[str, ...]) -> list[str]:
    return [f"{group}_{axis}" for group in groups for axis in axes]


def to_control(model: LinearModel, axes: tuple[str, ...] | None = None) -> Any:
    """The model as ``control.StateSpace``, with names of inputs and outputs.

    Args:
        model: a whole model, of `linearise`.
        axes: names of the axes; None: x, y, z.

    Raises:
        ValueError: where python-control is not installed.
    """
    try:
        import control  # python-control: the users' own tool; margins here need none of it
    except ImportError as error:
        raise ValueError("to_control needs python-control: pip install control") from error
    names = axes or tuple("xyz"[: model.axes])
    a, b, c, d = (np.asarray(x) for x in model[:4])
    inputs, outputs = _names(INPUTS, names), _names(OUTPUTS, names)
    return control.StateSpace(a, b, c, d, float(model.dt), inputs=inputs, outputs=outputs)


def to_scipy(model: LinearModel) -> Any:
    """The model as ``scipy.signal.StateSpace`` (discrete time)."""
    from scipy.signal import StateSpace

    a, b, c, d = (np.asarray(x) for x in model[:4])
    return StateSpace(a, b, c, d, dt=float(model.dt))
