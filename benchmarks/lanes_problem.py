"""What `benchmarks/lanes.py` trains: one learner on random rows, of Hopper's shape or of three robots in turn."""

import dataclasses
import functools
import time
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr

from benchmarks import learners
from odaf.components.networks import Products
from odaf.data.padding import Padding
from odaf.data.sampling import padded_columns
from odaf.data.spec import Spec
from odaf.runs import presets
from odaf.training import loop
from odaf.training.run_directory import blank_state
from odaf.training.widths import PaddedState, widths_of, with_widths

# Observations and actions of Hopper, HalfCheetah and Walker2d.
ROBOTS = ((11, 3), (17, 6), (17, 6))


@dataclasses.dataclass(frozen=True)
class Setting:
    """A learner's size, and what it learns from.

    Attributes:
        preset: its name.
        hidden_sizes: of every network.
        critics: how many, where the preset can be told.
        batch: rows of an update.
        products: format of the critics' hidden layers, where the preset can be told; None leaves the preset's.
        sets: data sets; several are of three robots in turn, and lanes draw from them in turn.
        rows: of each data set.
    """

    preset: str
    hidden_sizes: tuple[int, ...]
    critics: int
    batch: int
    products: Products | None = None
    sets: int = 1
    rows: int = learners.ROWS

    def learner(self) -> Any:
        """The learner; what the preset does not have is left out."""
        changes: dict[str, Any] = {"hidden_sizes": self.hidden_sizes, "batch_size": self.batch}
        plain = presets.load(self.preset)
        if hasattr(plain, "num_critics"):
            changes["num_critics"] = self.critics
        if hasattr(plain, "products") and self.products is not None:
            changes["products"] = self.products
        return presets.load(self.preset, changes)

    def spec(self, place: int) -> Spec:
        """The task of a lane's data set."""
        if self.sets == 1:
            return learners.SPEC
        return _with_bounds(*ROBOTS[place % self.sets % len(ROBOTS)])

    @property
    def widest(self) -> tuple[int, int] | None:
        """What rows and networks are padded to; None where there is one data set."""
        if self.sets == 1:
            return None
        own = ROBOTS[: self.sets]
        return max(states for states, _ in own), max(actions for _, actions in own)

    @property
    def own_widths(self) -> tuple[tuple[int, int], ...]:
        """Numbers of observations and actions that occur, where rows are padded."""
        return () if self.sets == 1 else tuple(sorted(set(ROBOTS[: self.sets])))

    def columns(self, place: int) -> Any:
        """A lane's own rows."""
        return learners.columns(self.learner().view().extras, self.spec(place), self.rows)

    def all_columns(self) -> Any:
        """The rows of all data sets, one behind the other."""
        if self.widest is None:
            return self.columns(0)
        padded = [padded_columns(self.columns(place), self.widest) for place in range(self.sets)]
        return jax.tree.map(lambda *parts: jnp.concatenate(parts), *padded)

    def state(self, place: int) -> Any:
        """A lane's first state, with untrained models: their values do not change what an update costs."""
        learner, spec, key = self.learner(), self.spec(place), jr.key(1)
        return loop.donatable(loop.first_state(learner, spec, key, learner.untrained(key, spec)))


def compiled(setting: Setting, lanes: int) -> tuple[Any, float]:
    """(the program of so many lanes, seconds that it took to compile).

    Raises:
        SystemExit: data sets of three robots are asked for, and the learner cannot be padded.
    """
    algorithm, began = setting.learner(), time.perf_counter()
    if setting.widest is not None and not algorithm.can_be_padded():
        raise SystemExit(f"{setting.preset} has no padded form with these settings; leave out --sets")
    spec = learners.SPEC if setting.widest is None else with_widths(learners.SPEC, setting.widest)
    columns = jax.eval_shape(setting.all_columns)
    program = loop.compiled_lanes(
        algorithm, columns, setting.sets > 1, blank_state(algorithm, spec), lanes, setting.own_widths
    )
    return program, time.perf_counter() - began


class Lanes:
    """So many lanes of a compiled program, two updates old.

    Args:
        setting: of the learner.
        program: of `compiled`.
        lanes: how many.
    """

    def __init__(self, setting: Setting, program: Any, lanes: int):
        _, numbers = loop.split_lanes([setting.learner()] * lanes)
        firsts = [place % setting.sets * setting.rows for place in range(lanes)]
        slabs = padding = None
        if setting.widest is None:
            states = [setting.state(0)] * lanes
        else:
            slabs = jnp.asarray(firsts, jnp.int32), jnp.full((lanes,), setting.rows, jnp.int32)
            padding = _padding(setting, lanes)
            states = _padded_states(setting, lanes)
        rows, keys = jax.jit(setting.all_columns)(), jr.split(jr.key(0), lanes)
        self._states, self._done = loop.stacked(states), 0
        self._train = functools.partial(program, numbers, rows, slabs, keys)
        self._padding = padding
        self.train(2)

    def train(self, updates: int) -> float:
        """Makes so many updates of each; returns the seconds that they took."""
        number, before = loop.update_number, time.perf_counter()
        last = self._done + updates
        found = self._train(number(self._done), number(last), self._states, self._padding)
        self._states, self._done = jax.block_until_ready(found)[0], last
        return time.perf_counter() - before


def _padding(setting: Setting, lanes: int) -> Padding:
    return loop.padding_of([widths_of(setting.spec(place)) for place in range(lanes)], setting.own_widths)


def _padded_states(setting: Setting, lanes: int) -> list[Any]:
    assert setting.widest is not None
    of_spec: dict[Spec, Any] = {}
    for place in range(min(lanes, setting.sets)):
        spec = setting.spec(place)
        if spec not in of_spec:
            of_spec[spec] = PaddedState(setting.learner(), spec, setting.widest).pad(setting.state(place))
    return [of_spec[setting.spec(place)] for place in range(lanes)]


def _with_bounds(obs_dim: int, act_dim: int) -> Spec:
    return dataclasses.replace(
        learners.SPEC, obs_dim=obs_dim, act_dim=act_dim, action_low=(-1.0,) * act_dim, action_high=(1.0,) * act_dim
    )
