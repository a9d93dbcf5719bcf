"""Which settings of a learner are traced numbers, and which decide the compiled program.

A learning rate, a weight, a radius or a discount only scales something. As a constant of the compiled program each new
value would compile the program anew, which takes longer than thousands of updates. So they enter as arrays: `split`
takes them out of a learner, `joined` puts them back inside the traced code.
"""

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from odaf.algorithms.base import Algorithm

Settings = TypeVar("Settings")
Numbers = dict[str, Float[Array, ""]]


class _Traced:
    """Stands in a structure where a number was."""

    def __repr__(self) -> str:
        return "<traced>"


TRACED = _Traced()


def is_off(number: Any) -> bool:
    """Whether a setting is exactly 0, which leaves its part out of the program; a traced number never is."""
    return isinstance(number, int | float) and number == 0


def split(algorithm: Algorithm) -> tuple[Algorithm, Numbers]:
    """(structure, numbers) of a learner.

    Numbers are the floating-point settings other than 0, those of terms and of other nested settings too, by path, but
    for the fields that a class names in `structural`. Learners with equal structures share one compiled program.
    """
    numbers: Numbers = {}
    return _without_numbers(algorithm, "", numbers), numbers


def joined(structure: Algorithm, numbers: Mapping[str, Any]) -> Algorithm:
    """The learner of a structure and its numbers, which may be tracers; nothing is validated again."""
    return _with_numbers(structure, "", numbers)


def _without_numbers(value: Any, path: str, numbers: Numbers) -> Any:
    if _is_settings(value):
        kept = getattr(type(value), "structural", frozenset())
        return changed(
            value,
            {
                field.name: _without_numbers(getattr(value, field.name), f"{path}.{field.name}", numbers)
                for field in dataclasses.fields(value)
                if field.name not in kept
            },
        )
    if isinstance(value, tuple):
        return tuple(_without_numbers(item, f"{path}.{index}", numbers) for index, item in enumerate(value))
    if isinstance(value, float) and not is_off(value):
        numbers[path] = jnp.asarray(value, jnp.float32)
        return TRACED
    return value


def _with_numbers(value: Any, path: str, numbers: Mapping[str, Any]) -> Any:
    if _is_settings(value):
        return changed(
            value,
            {
                field.name: _with_numbers(getattr(value, field.name), f"{path}.{field.name}", numbers)
                for field in dataclasses.fields(value)
            },
        )
    if isinstance(value, tuple):
        return tuple(_with_numbers(item, f"{path}.{index}", numbers) for index, item in enumerate(value))
    return numbers[path] if value is TRACED else value


def _is_settings(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def changed(settings: Settings, fields: Mapping[str, Any]) -> Settings:
    """A copy with other fields; `dataclasses.replace` would validate them, and a tracer has no value to judge."""
    changed = copy.copy(settings)
    for name, value in fields.items():
        object.__setattr__(changed, name, value)
    return changed
