"""A control law of a study."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol, TypeVar

from jax import Array

from jaxstage.model.blocks import Controller


class StudyLaw(NamedTuple):
    """A controller of a study, its gains, and what of them and of its memory is looked at.

    Attributes:
        gains: Makes the gains, of what the study's `build` hands it.
        surface: Picks the sliding variable out of the memory.
        schedule: Picks scheduled contour gains K_P, K_I, K_D out of the memory.
        adapting: Picks what adapts out of memory and control period: slope, switching gain,
            sharpness and the sampled gain of the switch.
        observed: Picks sliding mode and observer out of the gains.
    """

    name: str
    summary: str
    controller: Controller
    gains: Callable[..., Any]
    surface: Callable[[Any], Array] | None = None
    schedule: Callable[[Any], tuple[Array, Array, Array]] | None = None
    adapting: Callable[[Any, float], tuple[Array, Array, Array, Array]] | None = None
    observed: Callable[[Any], Any] | None = None


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=_Named)


def named(entries: Iterable[T], name: str) -> T:
    """The entry called ``name``."""
    return next(entry for entry in entries if entry.name == name)
