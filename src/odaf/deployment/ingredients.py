"""What a guard is made of: the run's own critics and dynamics, or such that are fitted to its log; and a clone."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from odaf.components.behaviour_models import BehaviourConfig, fit_clone
from odaf.components.critics import CriticEnsemble
from odaf.components.dynamics import DynamicsConfig, DynamicsModel, fit_dynamics
from odaf.components.fitting import Progress
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.deployment.values import fit_critics
from odaf.errors import ConfigError
from odaf.training.averaging import learner_state
from odaf.training.policy import Policy


@dataclass(frozen=True)
class GuardSettings:
    """Sizes of what a guard is made of."""

    references: int = 1_024
    """Rows of the log that distances are measured to."""
    members: int = 4
    """Critics to fit where the learner has fewer than two."""
    discount: float = 0.99
    """Weight of a reward one step later in what these critics learn."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of what is fitted."""
    steps: int = 10_000
    """Gradient steps of each fit."""
    batch_size: int = 256
    """Rows a gradient step (and a member)."""

    def __post_init__(self) -> None:
        for field, least in (("references", 2), ("members", 2), ("steps", 1), ("batch_size", 1)):
            if getattr(self, field) < least:
                raise ConfigError(f"{field}={getattr(self, field)} must be at least {least}")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if not 0.0 <= self.discount < 1.0:
            raise ConfigError(f"discount={self.discount} must lie in [0, 1), for instance 0.99")


class Ingredients(NamedTuple):
    """What a guard is made of.

    Attributes:
        critics: Q_k.
        outcome: f.
        clone: of whoever wrote the log; None where nobody asked for it.
        said: where critics, dynamics and clone come from, in words, and under "warnings" what to know of them.
    """

    critics: CriticEnsemble
    outcome: DynamicsModel
    clone: Actor | None
    said: dict[str, Any]


def ingredients(
    policy: Policy,
    state: Any,
    log: Dataset,
    wants_clone: bool,
    settings: GuardSettings,
    keys: Key[Array, " keys"],
    progress: Progress,
) -> Ingredients:
    """Takes what the learner has, and fits what it lacks.

    Args:
        policy: to guard.
        state: the learner and its state; None where there is a policy alone.
        log: what it learned from.
        wants_clone: whether a clone is to be fitted.
        settings: sizes.
        keys: a random key for each fit.
        progress: called with (steps done, steps in all).

    Raises:
        DivergenceError: a fit stopped being finite.
    """
    critics, outcome = (None, None) if state is None else (_own_critics(*state), _own_dynamics(state[1], policy))
    fits = (critics is None) + (outcome is None) + wants_clone
    stages = iter(range(fits))

    def stage() -> Progress:
        before = next(stages) * settings.steps
        return lambda done, total: progress(before + done, fits * settings.steps)

    said: dict[str, Any] = {"warnings": []}
    if outcome is None:
        config = DynamicsConfig(
            hidden_sizes=settings.hidden_sizes, steps=settings.steps, batch_size=settings.batch_size
        )
        outcome, report = fit_dynamics(
            config,
            log,
            policy.normaliser,
            keys[0],
            stage(),
            use="the guard's disagreement and surprise say little",
            remedy="log the state after each action",
        )
        said["dynamics"] = f"fitted to the log, {report['error_ratio']:.2g} of the error of 'no change'"
        said["warnings"] += report["warnings"]
    else:
        said["dynamics"] = "the run's own"
    if critics is None:
        critics = fit_critics(
            policy.actor,
            log,
            policy.normaliser,
            keys[1],
            members=settings.members,
            hidden_sizes=settings.hidden_sizes,
            discount=settings.discount,
            steps=settings.steps,
            batch_size=settings.batch_size,
            progress=stage(),
        )
        said["critics"] = f"{settings.members} fitted to the log, of the policy at discount {settings.discount:g}"
    else:
        said["critics"] = f"the run's own {critics.networks.weights[0].shape[0]}"
    clone = None
    if wants_clone:
        config = BehaviourConfig(
            hidden_sizes=settings.hidden_sizes, steps=settings.steps, batch_size=settings.batch_size
        )
        clone, report = fit_clone(config, log, policy.normaliser, keys[2], stage())
        said["clone"] = f"mean squared error {report['holdout_error']:.3g} of actions in [-1, 1]"
        said["warnings"] += report["warnings"]
    return Ingredients(critics, outcome, clone, said)


def _own_critics(algorithm: Any, state: Any) -> CriticEnsemble | None:
    critics = algorithm.values(learner_state(state))
    return critics if critics is not None and critics.networks.weights[0].shape[0] > 1 else None


def _own_dynamics(state: Any, policy: Policy) -> DynamicsModel | None:
    """A model of the next state among what the learner was built around; None where there is none that sees actions."""

    def is_model(node: Any) -> bool:
        return isinstance(node, DynamicsModel)

    row, action = (jax.ShapeDtypeStruct((1, width), jnp.float32) for width in (policy.obs_dim, policy.act_dim))
    for model in filter(is_model, jax.tree.leaves(state, is_leaf=is_model)):
        try:
            jax.eval_shape(lambda model, row, action: model.expected(row, action), model, row, action)
        except TypeError:  # it sees no actions
            continue
        return model
    return None
