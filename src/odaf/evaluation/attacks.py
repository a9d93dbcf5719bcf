"""Attacks on what a policy sees: offsets of its observation, small and chosen to do harm.

Only the policy is deceived. It is given s + delta with |delta_i| <= budget * std_i, std being that of the logged
observations, while the environment stays in s and the critics that an attack may ask are told s. An attack draws
candidates in this box, climbs from each of them along the gradient for some steps, and keeps the most harmful one:

    random        no objective, one draw
    action-diff   largest  KL(pi(s) || pi(s + delta)) + KL(pi(s + delta) || pi(s))   of the Gaussians before the tanh
    min-q         smallest mean_k Q_k(s, mu(s + delta))
    min-q-std     largest  std_k  Q_k(s, mu(s + delta))

By sampling: the best of 50 draws, for the two that ask the critics also of delta = 0. First order: 1 draw and 10 steps.
Mixed order: the best of 20 draws with 10 steps each. The critics are those of the attacked learner itself, or those of
another learner of the same task: so learners without critics are attacked, and all can be judged alike.

Source: Yang et al. 2022 (RORL) and its code, which attacks one observation at a time; here every row has its own
draws. A constant factor of the code's objectives is left out; it moves neither the best candidate nor a step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.components.critics import CriticEnsemble, disagreement
from odaf.components.distributions import symmetric_gaussian_divergence
from odaf.components.perturbations import draw_offsets
from odaf.components.policies import Actor, SquashedGaussianActor
from odaf.errors import ConfigError
from odaf.training.averaging import learner_state
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory

StepRule = Literal["pgd", "rorl"]
PGD_STEP, RORL_STEP = 0.2, 0.1
ADAM_EPSILON = 1e-8

Harm = Callable[[Float[Array, "draws rows obs_dim"]], Float[Array, "draws rows"]]


@dataclass(frozen=True)
class Attack:
    """How an offset is looked for.

    Attributes:
        name: what users type.
        objective: what is climbed; None takes a draw as it comes.
        draws: uniform draws in the box for each row.
        steps: gradient steps from each draw.
        with_clean: whether delta = 0 is one more candidate.
    """

    name: str
    objective: Literal["action-diff", "min-q", "min-q-std"] | None
    draws: int
    steps: int
    with_clean: bool = False

    @property
    def asks_critics(self) -> bool:
        """Whether the objective is a matter of values."""
        return self.objective in ("min-q", "min-q-std")


ATTACKS = {
    attack.name: attack
    for attack in (
        Attack("random", None, draws=1, steps=0),
        Attack("action-diff", "action-diff", draws=50, steps=0),
        Attack("min-q", "min-q", draws=50, steps=0, with_clean=True),
        Attack("min-q-std", "min-q-std", draws=50, steps=0, with_clean=True),
        Attack("action-diff-first-order", "action-diff", draws=1, steps=10),
        Attack("min-q-first-order", "min-q", draws=1, steps=10),
        Attack("min-q-std-first-order", "min-q-std", draws=1, steps=10),
        Attack("action-diff-mixed-order", "action-diff", draws=20, steps=10),
        Attack("min-q-mixed-order", "min-q", draws=20, steps=10),
        Attack("min-q-std-mixed-order", "min-q-std", draws=20, steps=10),
    )
}


class Judge(eqx.Module):
    """The critics that an attack asks, their learner's scale of observations, and the task that they know."""

    critics: CriticEnsemble
    mean: Float[Array, " obs_dim"]
    scale: Float[Array, " obs_dim"]
    action_low: tuple[float, ...] = eqx.field(static=True)
    action_high: tuple[float, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, run: RunDirectory, seed: int, step: int | None = None) -> "Judge":
        """The critics of a run's seed after `step` updates (None: at its last checkpoint).

        Raises:
            CheckpointError: there is no such checkpoint.
            ConfigError: the learner has no critics.
        """
        critics = run.algorithm.values(learner_state(run.state(seed, step)))
        if critics is None:
            raise ConfigError(
                f"{run.path}: an attack that asks critics needs a run that has some, and the learner "
                f"'{run.algorithm.kind}' has none; name one that has (--attacker DIR), or attack at random"
            )
        mean, scale = jnp.asarray(run.normaliser.shift), jnp.asarray(run.normaliser.scale)
        return cls(critics, mean, scale, run.spec.action_low, run.spec.action_high)

    def values(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "critics rows"]:
        """Q_k(s, a) for observations in the user's units and actions in [-1, 1]."""
        return self.critics.as_constants((observations - self.mean[None, :]) / self.scale[None, :], actions)


class AttackedActor(eqx.Module):
    """What an attacker knows of a policy: its actor and the scale of observations that it acts on."""

    actor: Actor
    mean: Float[Array, " obs_dim"]
    scale: Float[Array, " obs_dim"]

    def gaussian(
        self, observations: Float[Array, "rows obs_dim"]
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "rows act_dim"]]:
        """Mean and log standard deviation before the tanh, for observations in the user's units."""
        assert isinstance(self.actor, SquashedGaussianActor)
        return self.actor.parameters(self._normalised(observations))

    def mode(self, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows act_dim"]:
        """mu(s), the deterministic action in [-1, 1], for observations in the user's units."""
        return self.actor.mode(self._normalised(observations))

    def _normalised(self, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows obs_dim"]:
        return (observations - self.mean[None, :]) / self.scale[None, :]


ThreatModel = tuple[AttackedActor, Judge | None]  # who is harmed, and whom the objective asks


def threat_model(policy: Policy, attack: Attack, judge: Judge | None = None) -> ThreatModel | None:
    """What the attack knows; None for an attack without an objective.

    Args:
        policy: whom to harm.
        attack: how.
        judge: the critics that are asked, of the policy's own learner or of another one on the same task.

    Raises:
        ConfigError: the policy computes its observations of readings; the objective asks for a Gaussian policy, for one
            without a memory or for critics, and there is none; the judge knows another task, or the attack has no use
            for one.
    """
    if judge is not None and not attack.asks_critics:
        users = ", ".join(name for name, other in ATTACKS.items() if other.asks_critics)
        raise ConfigError(f"attacker: attack '{attack.name}' asks no critics; leave it out, or choose one of {users}")
    if policy.derivation is not None:
        raise ConfigError(
            f"attack '{attack.name}': moves observations within the spread of the logged ones, and this policy "
            f"computes its {policy.obs_dim} observations of readings ({', '.join(policy.reading_names)}); attack it in "
            "an environment that gives the observations themselves, or policy.without_derivation()"
        )
    if attack.objective is None:
        return None
    learner = policy.provenance.get("learner", type(policy.actor).__name__)
    if policy.has_memory:
        raise ConfigError(
            f"attack '{attack.name}': looks one step ahead, and the policy of the learner '{learner}' has a memory; "
            "attack it at random"
        )
    if attack.objective == "action-diff" and not isinstance(policy.actor, SquashedGaussianActor):
        raise ConfigError(
            f"attack '{attack.name}': needs a Gaussian policy, and that of the learner '{learner}' is not; "
            "attack it by min-q with the critics of another run (--attacker DIR), or at random"
        )
    if attack.asks_critics:
        if judge is None:
            raise ConfigError(
                f"attack '{attack.name}': asks critics, which a policy does not hold; "
                "give those of a run, as judge=Judge.of(run, seed)"
            )
        _check_same_task(policy, judge)
    normaliser = policy.normaliser
    return AttackedActor(policy.actor, jnp.asarray(normaliser.shift), jnp.asarray(normaliser.scale)), judge


def _check_same_task(policy: Policy, judge: Judge) -> None:
    pairs = {
        "obs_dim": (policy.obs_dim, judge.mean.shape[0]),
        "act_dim": (policy.act_dim, len(judge.action_low)),
        "action_low": (policy.action_low, judge.action_low),
        "action_high": (policy.action_high, judge.action_high),
    }
    for field, (ours, theirs) in pairs.items():
        if ours != theirs:
            raise ConfigError(
                f"attacker: its data have {field} {theirs}, those of the attacked policy {ours}; "
                "take a run on the same task"
            )


def harm_of(objective: str, threat: ThreatModel, observations: Float[Array, "rows obs_dim"]) -> Harm:
    """The objective of an attack at these observations: larger is worse for the policy. Rows do not interact."""
    attacked, judge = threat

    def harm(offsets: Float[Array, "draws rows obs_dim"]) -> Float[Array, "draws rows"]:
        draws, rows, obs_dim = offsets.shape
        seen = (observations[None] + offsets).reshape(draws * rows, obs_dim)
        if judge is None:
            mean, log_std = (jnp.tile(parameter, (draws, 1)) for parameter in attacked.gaussian(observations))
            divergence = symmetric_gaussian_divergence(mean, log_std, *attacked.gaussian(seen))
            return jnp.sum(divergence, axis=-1).reshape(draws, rows)
        values = judge.values(jnp.tile(observations, (draws, 1)), attacked.mode(seen))
        found = -jnp.mean(values, axis=0) if objective == "min-q" else disagreement(values)
        return found.reshape(draws, rows)

    return harm


def climb(
    harm: Harm,
    offsets: Float[Array, "draws rows obs_dim"],
    box: Float[Array, " obs_dim"],
    budget: Float[Array, ""],
    steps: int,
    rule: StepRule,
) -> Float[Array, "draws rows obs_dim"]:
    """Offsets after `steps` steps up the gradient, clipped to the box after each.

    Args:
        harm: one value for each draw and row, which do not interact.
        offsets: starting points inside the box, in the user's units.
        box: largest size of an offset in each dimension.
        budget: the box in standard deviations.
        steps: how many.
        rule: "pgd" moves by 0.2 box times the sign of the gradient. "rorl" is the published code: the first step of a
            fresh Adam at every step, 0.1 budget g / (|g| + 1e-8), in the units of the observation and blind to their
            scale, so that wide dimensions are hardly explored and narrow ones go to an edge at once.
    """
    gradient_of = jax.grad(lambda candidate: jnp.sum(harm(candidate)))

    def step(_: Int[Array, ""], current: Float[Array, "draws rows obs_dim"]) -> Float[Array, "draws rows obs_dim"]:
        gradient = gradient_of(current)
        if rule == "pgd":
            move = PGD_STEP * box[None, None, :] * jnp.sign(gradient)
        else:
            move = RORL_STEP * budget * gradient / (jnp.abs(gradient) + ADAM_EPSILON)
        return jnp.clip(current + move, -box[None, None, :], box[None, None, :])

    return jax.lax.fori_loop(0, steps, step, offsets)


def worst_offsets(
    attack: Attack,
    rule: StepRule,
    threat: ThreatModel | None,
    observations: Float[Array, "rows obs_dim"],
    std: Float[Array, " obs_dim"],
    budget: Float[Array, ""],
    key: PRNGKeyArray,
) -> Float[Array, "rows obs_dim"]:
    """The attack's offset for every row: |delta_i| <= budget * std_i, in the user's units. Pure and traceable.

    Args:
        attack: how to look for it.
        rule: gradient steps of attacks that take any; see `climb`.
        threat: whom to harm and whom to ask; None only for an attack without an objective.
        observations: true observations in the user's units.
        std: standard deviation of each dimension of the logged observations.
        budget: size of the box in standard deviations.
        key: random key.
    """
    rows, obs_dim = observations.shape
    box = budget * std
    candidates = attack.draws + int(attack.with_clean)
    unit = draw_offsets(key, candidates, rows, obs_dim, 1.0, shared=False, include_centre=attack.with_clean)
    offsets = unit * box[None, None, :]
    if attack.objective is None or threat is None:
        return offsets[0]
    harm = harm_of(attack.objective, threat, observations)
    if attack.steps:
        offsets = climb(harm, offsets, box, budget, attack.steps, rule)
    if candidates == 1:
        return offsets[0]
    best = jnp.argmax(harm(offsets), axis=0)
    return jnp.take_along_axis(offsets, best[None, :, None], axis=0)[0]


class AttackedPolicy:
    """A policy that sees what an attack shows it; itself a policy, for `rollout`.

    Every call is the next step of all episodes and has draws of its own, so one object plays one rollout. The attack is
    compiled once for all calls, budgets and seeds of a learner with equally many rows.

    Args:
        policy: whom to harm.
        attack: how, one of `ATTACKS`.
        budget: size of the box in standard deviations of the logged observations.
        key: random key of the draws.
        rule: gradient steps of attacks that take any; see `climb`.
        judge: the critics that are asked, for attacks that ask any.

    Raises:
        ConfigError: as `threat_model`.
    """

    def __init__(
        self,
        policy: Policy,
        attack: Attack,
        budget: float,
        key: PRNGKeyArray,
        rule: StepRule = "pgd",
        judge: Judge | None = None,
    ):
        self.policy = policy
        self._attack, self._key, self._calls = attack, key, 0
        self._rule: StepRule = rule
        self._threat = threat_model(policy, attack, judge)
        self._std, self._budget = jnp.asarray(policy.normaliser.std), jnp.asarray(budget, jnp.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """The policy's actions [rows, act_dim] at attacked observations [rows, obs_dim]."""
        return self.policy(self.shown(observations))

    def begin(self, rows: int) -> PyTree:
        """As `Policy.begin`."""
        return self.policy.begin(rows)

    def act(self, carry: PyTree, observations: np.ndarray) -> tuple[np.ndarray, PyTree]:
        """As `Policy.act`, at attacked observations [rows, obs_dim]."""
        return self.policy.act(carry, self.shown(observations))

    def observe(self, carry: PyTree, rewards: np.ndarray) -> PyTree:
        """As `Policy.observe`; rewards are not tampered with."""
        return self.policy.observe(carry, rewards)

    def shown(self, observations: np.ndarray) -> np.ndarray:
        """[rows, obs_dim] float32: what the policy is shown in place of the true observations at this call."""
        true, calls = jnp.asarray(observations, jnp.float32), jnp.asarray(self._calls)
        self._calls += 1
        return np.asarray(
            _shown(self._attack, self._rule, self._threat, true, self._std, self._budget, self._key, calls)
        )


@eqx.filter_jit
def _shown(
    attack: Attack,
    rule: StepRule,
    threat: ThreatModel | None,
    observations: Float[Array, "rows obs_dim"],
    std: Float[Array, " obs_dim"],
    budget: Float[Array, ""],
    key: PRNGKeyArray,
    calls: Int[Array, ""],
) -> Float[Array, "rows obs_dim"]:
    return observations + worst_offsets(attack, rule, threat, observations, std, budget, jr.fold_in(key, calls))
