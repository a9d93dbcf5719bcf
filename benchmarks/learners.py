"""The learners that are timed, on Hopper's shapes with batches of 256 rows.

Ensembles all have ten critics and three layers of 256. The others have the sizes that they are published with; those
that d3rlpy has too, the sizes and numbers of actions of `benchmarks.parity.settings`.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from benchmarks.parity import settings
from odaf.algorithms.base import Metrics
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.numbers import Numbers, joined, split
from odaf.algorithms.terms.base import Context
from odaf.algorithms.terms.outcome_penalty import OutcomePenalty
from odaf.components.dynamics import DynamicsModel
from odaf.components.targets import frozen
from odaf.data.sampling import sample
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.runs import presets
from odaf.training.loop import donatable

SPEC = Spec(11, 3, (-1.0,) * 3, (1.0,) * 3, 0.0, 1.0, False, 1000)
PROBLEM = {"hidden_sizes": (256, 256, 256), "num_critics": 10, "batch_size": 256}
ROWS = 200_000

# (learner with traced numbers, state, batch, key) -> state
Part = Callable[[Any, Any, Transitions, PRNGKeyArray], Any]

# Name in the table: preset, and what is changed beside the common problem.
NAMES: dict[str, tuple[str, dict[str, Any]]] = {
    "sac-n": ("sac-n", {}),
    "edac": ("edac", {}),
    "pbrl": ("pbrl", {}),
    "odaf-base": ("odaf-without-outcome", {}),
    "odaf-default": ("odaf", {}),
    "odaf": ("odaf", {"outcome.num_states": None}),
    "odaf-sampled": ("odaf", {"outcome.num_states": None, "outcome.solver": "sample", "outcome.num_draws": 20}),
    "odaf-sampled-naive": ("odaf", {"outcome.num_states": None, "outcome.solver": "sample", "outcome.num_draws": 20}),
    "sac-n-bfloat16": ("sac-n", {"products": "bfloat16"}),
    "odaf-bfloat16": ("odaf", {"outcome.num_states": None, "products": "bfloat16"}),
    "odaf-paper": ("odaf-paper", {}),
    "rorl": ("rorl", {}),
    "odaf-demo": ("odaf-demo", {}),
}


def _others() -> tuple[str, ...]:
    """A preset for each kind of learner that is no ensemble: the one of its name, or the first."""
    by_kind: dict[str, list[str]] = {}
    for name in presets.names():
        by_kind.setdefault(presets.settings(name)["kind"], []).append(name)
    by_kind.pop(EnsembleSAC.kind)
    return tuple(kind if kind in names else names[0] for kind, names in by_kind.items())


OTHERS = _others()


@dataclasses.dataclass(frozen=True)
class NaiveOutcomePenalty(OutcomePenalty):
    """The sample solver written down as in the paper: all draws at once, and the maximum over all of them derived."""

    def worst_case(self, context: Context, dynamics: DynamicsModel, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """Worst U over the draws; differentiated through every one of them."""
        context, dynamics = self._without_gradients(context), frozen(dynamics)
        states = context.batch.observations
        rows, obs_dim = states.shape
        key_noise, key_offsets = jr.split(key)
        box = jr.uniform(key_offsets, (self.num_draws, rows, obs_dim), minval=-self.radius, maxval=self.radius)
        noise = self._draw_noise(context, dynamics, self.num_draws * rows, key_noise)
        perturbed = (states[None] + box).reshape(-1, obs_dim)
        uncertainty = self.outcome_uncertainty(context, context.actor, dynamics, perturbed, noise)
        return jnp.max(uncertainty.reshape(self.num_draws, rows), axis=0)


def load(name: str) -> Any:
    """The learner of this name, on the common problem."""
    if name in OTHERS:
        changes = {**settings.LEARNERS.get(name, {}), "batch_size": PROBLEM["batch_size"]}
        if "warm_up_steps" in presets.settings(name):
            changes["warm_up_steps"] = 0  # afterwards, an update costs most
        return presets.load(name, changes)
    preset, changes = NAMES[name]
    algorithm = presets.load(preset, {**PROBLEM, **changes})
    if name.endswith("-naive"):
        terms = tuple(
            NaiveOutcomePenalty(**{field.name: getattr(term, field.name) for field in dataclasses.fields(term)})
            for term in algorithm.terms
        )
        algorithm = dataclasses.replace(algorithm, terms=terms)
    return algorithm


def columns(extras: Sequence[str] = (), spec: Spec = SPEC, rows: int = ROWS) -> Transitions:
    """Random transitions of a task's shapes, with the extra columns that a learner's view asks for."""
    keys = jr.split(jr.key(0), 4)
    widths = {"next_actions": (spec.act_dim,)}
    return Transitions(
        jr.normal(keys[0], (rows, spec.obs_dim)),
        jr.uniform(keys[1], (rows, spec.act_dim), minval=-1.0, maxval=1.0),
        jr.uniform(keys[2], (rows,)),
        jr.normal(keys[3], (rows, spec.obs_dim)),
        jnp.zeros(rows),
        {name: jnp.ones((rows, *widths.get(name, ()))) for name in extras},
    )


def state_of(algorithm: Any) -> Any:
    """An untrained state, with untrained models: their values do not change what an update costs."""
    key = jr.key(1)
    return algorithm.init(key, SPEC, algorithm.untrained(key, SPEC))


def repeated(algorithm: Any, rows: Transitions, part: Part, state: Any) -> Callable[[int], None]:
    """A function of a number: make `part` that often in one compiled loop, on fresh batches, and wait for the end."""
    arrays, static = eqx.partition(donatable(state), eqx.is_array)  # of strong types, or a second call compiles anew
    structure, numbers = split(algorithm)

    @functools.partial(jax.jit, donate_argnums=2)
    def stretch(numbers: Numbers, rows: Transitions, arrays: Any, count: Array) -> Any:
        learner = joined(structure, numbers)

        def step(index: Array, arrays: Any) -> Any:
            key_batch, key_update = jr.split(jr.fold_in(jr.key(2), index))
            batch = sample(rows, key_batch, algorithm.batch_size)
            return eqx.partition(part(learner, eqx.combine(arrays, static), batch, key_update), eqx.is_array)[0]

        return jax.lax.fori_loop(0, count, step, arrays)

    carried = [arrays]

    def call(count: int) -> None:
        carried[0] = jax.block_until_ready(stretch(numbers, rows, carried[0], jnp.asarray(count)))

    return call


def updates(algorithm: Any, rows: Transitions) -> Callable[[int], None]:
    """A function of a number that makes that many updates."""

    def part(learner: Any, state: Any, batch: Transitions, key: PRNGKeyArray) -> Any:
        new_state: tuple[Any, Metrics] = learner.update(state, batch, key)
        return new_state[0]

    return repeated(algorithm, rows, part, state_of(algorithm))
