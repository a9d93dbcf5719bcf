"""When a task ends, as a function of a transition: what rollouts of a model stop by, since a model does not know it.

A function of one's own has a name, by which settings and files know it:

    @odaf.register
    def tank_overflows(observations, actions, next_observations):
        return next_observations[:, 0] > 2.5           # jax.numpy; true where the task ends with this step

    learner = odaf.preset("mopo", termination="tank_overflows")

States are in the log's units, actions in [-1, 1]. A package offers its functions by the entry points
`odaf.terminations`, and every command knows them then.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from odaf.errors import ConfigError

# (states, actions, next states) of rows -> whether the task ends with each
Termination = Callable[[Array, Array, Array], Array]

GROUP = "odaf.terminations"
FAR = 100.0  # a robot's coordinates beyond are no robot's


def never(
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    next_observations: Float[Array, "rows obs_dim"],
) -> Bool[Array, " rows"]:
    """Nowhere, as in mazes whose episodes a time limit cuts."""
    del observations, actions
    return jnp.zeros(next_observations.shape[0], bool)


def halfcheetah(
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    next_observations: Float[Array, "rows obs_dim"],
) -> Bool[Array, " rows"]:
    """Where a model ran away: some |s'_i| >= 100. The robot itself never ends."""
    del observations, actions
    return _far(next_observations)


def hopper(
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    next_observations: Float[Array, "rows obs_dim"],
) -> Bool[Array, " rows"]:
    """Height at most 0.7, pitch at least 0.2 either way, or some |s'_i| >= 100 but for the height."""
    del observations, actions
    height, pitch = next_observations[:, 0], next_observations[:, 1]
    return (height <= 0.7) | (jnp.abs(pitch) >= 0.2) | _far(next_observations[:, 1:])


def walker2d(
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    next_observations: Float[Array, "rows obs_dim"],
) -> Bool[Array, " rows"]:
    """Height outside (0.8, 2), pitch outside (-1, 1), or some |s'_i| >= 100."""
    del observations, actions
    height, pitch = next_observations[:, 0], next_observations[:, 1]
    stands = (height > 0.8) & (height < 2.0) & (pitch > -1.0) & (pitch < 1.0)
    return ~stands | _far(next_observations)


def _far(observations: Float[Array, "rows some"]) -> Bool[Array, " rows"]:
    return jnp.any(jnp.abs(observations) >= FAR, axis=-1)


_KNOWN: dict[str, Termination] = {each.__name__: each for each in (never, halfcheetah, hopper, walker2d)}


def known() -> list[str]:
    """Names of all that there are, those built in first."""
    return [*_KNOWN, *sorted(name for name in entry_points(group=GROUP).names if name not in _KNOWN)]


def add(function: Any) -> Any:
    """Makes a function known under its own name.

    Raises:
        ConfigError: another function has that name. Programs that were compiled with it would go on with it.
    """
    name = getattr(function, "__name__", "")
    if not name.isidentifier():
        raise ConfigError(f"termination {function!r}: has no name that settings could hold; write it with `def`")
    before = _KNOWN.setdefault(name, function)
    if before is not function and _text(before) != _text(function):
        raise ConfigError(f"termination {name!r}: another function of this process has that name; choose another")
    return function


def _text(function: Any) -> Any:
    """What tells a function from one that was read in again, as in a notebook: its code and the values it holds."""
    if not hasattr(function, "__code__"):
        return id(function)
    held = tuple(repr(cell.cell_contents) for cell in function.__closure__ or ())
    return function.__code__, repr((function.__defaults__, function.__kwdefaults__)), held


def termination(name: str) -> Termination:
    """The function of a name.

    Raises:
        ConfigError: there is none; the message lists those that are known.
    """
    if name not in _KNOWN:
        for offered in entry_points(group=GROUP, name=name):
            _KNOWN[name] = offered.load()
    if name not in _KNOWN:
        raise ConfigError(
            f"termination={name!r} is not known; known: {', '.join(known())}. A function of your own becomes known by "
            f"odaf.register(function) in Python, or by an entry point {GROUP!r} of the package that offers it"
        )
    return _KNOWN[name]
