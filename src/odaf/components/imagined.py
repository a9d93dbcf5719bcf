"""Whole episodes played in a model of the log's system, and which of them a policy is to learn from."""

import functools
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from odaf.components.diffusion import ActionDiffusion
from odaf.components.dynamics import TransitionEnsemble
from odaf.data.spec import Spec
from odaf.errors import DivergenceError

MARGIN = 0.05  # of the range of a logged state, on each side
MOST_OUTSIDE = 0.1  # of the episodes that are learned from: more is worth a warning


class Imagined(eqx.Module):
    """Episodes that a policy learns from."""

    observations: Float[Array, "rollouts steps obs_dim"]  # normalised
    actions: Float[Array, "rollouts steps act_dim"]  # in [-1, 1]
    returns_to_go: Float[Array, "rollouts steps"]  # in the log's units, without a discount; a step's own reward counts


class Rollouts(NamedTuple):
    """Episodes side by side, on the host."""

    observations: Float[np.ndarray, "rollouts steps obs_dim"]
    actions: Float[np.ndarray, "rollouts steps act_dim"]
    rewards: Float[np.ndarray, "rollouts steps"]

    def returns(self) -> Float[np.ndarray, " rollouts"]:
        """Sums of rewards; minus infinity for an episode in which a number is not finite."""
        flat = [part.reshape(len(part), -1) for part in self]
        sound = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in flat])
        with np.errstate(invalid="ignore", over="ignore"):
            return np.where(sound, self.rewards.astype(np.float64).sum(axis=1), -np.inf)

    def inside(self, known: "Range") -> Bool[np.ndarray, " rollouts"]:
        """Whether no state of an episode lies outside of a range that is a twentieth wider on each side."""
        margin = MARGIN * (known.high - known.low)
        within = (self.observations >= known.low - margin) & (self.observations <= known.high + margin)
        return np.asarray(within.all(axis=(1, 2)))

    def taken(self, places: np.ndarray) -> "Rollouts":
        """Some of them."""
        return Rollouts(*(part[places] for part in self))


class Range(NamedTuple):
    """What states, by dimension, and rewards lie between."""

    low: Float[np.ndarray, " obs_dim"]
    high: Float[np.ndarray, " obs_dim"]
    reward_low: float
    reward_high: float

    @classmethod
    def of(cls, observations: Float[np.ndarray, "rows obs_dim"], rewards: Float[np.ndarray, " rows"]) -> "Range":
        """What these rows show."""
        return cls(observations.min(axis=0), observations.max(axis=0), float(rewards.min()), float(rewards.max()))

    @classmethod
    def endless(cls, obs_dim: int) -> "Range":
        """All numbers."""
        return cls(np.full(obs_dim, -np.inf, np.float32), np.full(obs_dim, np.inf, np.float32), -np.inf, np.inf)


class Kept(NamedTuple):
    """What was kept of all rollouts.

    Attributes:
        rollouts: those that pass first, in the order in which they came, then the others, the best first.
        passes: how many of these pass.
        returns: of all that were played, in the order in which they came.
        rounds: in which they were played.
    """

    rollouts: Rollouts
    passes: int
    returns: Float[np.ndarray, " played"]
    rounds: int


@functools.partial(jax.jit, static_argnames="steps")
def roll_out(
    dynamics: TransitionEnsemble,
    behaviour: ActionDiffusion,
    bounds: Range,
    starts: Float[Array, "rows obs_dim"],
    key: PRNGKeyArray,
    steps: int,
) -> tuple[Float[Array, "steps rows obs_dim"], Float[Array, "steps rows act_dim"], Float[Array, "steps rows"]]:
    """States, actions and rewards of an episode from each start, played by the behaviour model in the dynamics.

    States and rewards that the dynamics draw are cut to the bounds.
    """
    low, high = (jnp.asarray(end)[None] for end in bounds[:2])
    act_dim = behaviour.network.weights[-1].shape[-1]
    shape = behaviour.steps, starts.shape[0], act_dim

    def step(states: Array, key: PRNGKeyArray) -> tuple[Array, tuple[Array, Array, Array]]:
        key_action, key_draw = jr.split(key)
        actions = behaviour.sample(states, jr.normal(key_action, shape))
        after, rewards = dynamics.draw(states, actions, key_draw)
        rewards = jnp.clip(rewards, bounds.reward_low, bounds.reward_high)
        return jnp.clip(after, low, high), (states, actions, rewards)

    _, played = jax.lax.scan(step, starts, jr.split(key, steps))
    return played


def rounds_of(
    dynamics: TransitionEnsemble,
    behaviour: ActionDiffusion,
    bounds: Range,
    starts: Float[np.ndarray, "episodes obs_dim"],
    key: PRNGKeyArray,
    rounds: int,
    rows: int,
    steps: int,
) -> Iterator[Rollouts]:
    """Rounds of so many rollouts, each from a start that is drawn from all alike."""
    for number in range(rounds):
        key_start, key_play = jr.split(jr.fold_in(key, number))
        first = starts[np.asarray(jr.randint(key_start, (rows,), 0, len(starts)))]
        played = roll_out(dynamics, behaviour, bounds, jnp.asarray(first, jnp.float32), key_play, steps)
        yield Rollouts(*(np.swapaxes(np.asarray(part), 0, 1) for part in played))


def keep(rounds: Iterable[Rollouts], bar: float, wanted: int, progress: Callable[[int, int], None]) -> Kept:
    """The first `wanted` rollouts whose return is above the bar; where there are fewer, the best others beside them.

    Args:
        rounds: one or more, of which as many are taken as it needs; `wanted` rollouts in all at least.
        bar: what the sum of a rollout's rewards has to exceed to pass.
        wanted: how many to keep.
        progress: called with (rollouts that pass, wanted) after every round.
    """
    pool, played, passes = None, [], 0
    for found in rounds:
        played.append(found.returns())
        pool = found if pool is None else Rollouts(*map(np.concatenate, zip(pool, found, strict=True)))
        returns = pool.returns()
        fails = returns <= bar
        order = np.lexsort((np.where(fails, -returns, 0.0), fails))[:wanted]
        pool, passes = pool.taken(order), int((~fails[order]).sum())
        progress(passes, wanted)
        if passes == wanted:
            break
    assert pool is not None, "one round at least"
    return Kept(pool, passes, np.concatenate(played), len(played))


def returns_to_go(rewards: Float[np.ndarray, "rollouts steps"]) -> Float[np.ndarray, "rollouts steps"]:
    """g_t = R - sum_{j < t} r_j: what an episode earns from a step on, without a discount."""
    exact = rewards.astype(np.float64)
    before = np.cumsum(exact, axis=1) - exact
    return (exact.sum(axis=1, keepdims=True) - before).astype(np.float32)


def report_of(kept: Kept, bar: float, known: Range, spec: Spec) -> dict[str, Any]:
    """What was imagined and kept, and what to know of it.

    Args:
        kept: of `keep`.
        bar: the best logged return.
        known: what the log has shown.
        spec: of the log.

    Raises:
        DivergenceError: too few rollouts are finite.
    """
    wanted, steps = kept.rollouts.rewards.shape
    returns = kept.rollouts.returns()
    if not np.isfinite(returns).all():
        raise DivergenceError(
            f"rollouts: {int(np.isinf(returns).sum())} of the {wanted} best imagined episodes are not finite; "
            "train the dynamics on a log without outliers (`odaf data info`), or shorten rollout_steps"
        )
    passed, possible = int((kept.returns > bar).sum()), steps * spec.reward_max
    finite = kept.returns[np.isfinite(kept.returns)]
    report: dict[str, Any] = {
        "rounds": kept.rounds,
        "steps": steps,
        "played": len(kept.returns),
        "passed": passed,
        "kept": wanted,
        "kept_passed": kept.passes,
        "kept_outside": int((~kept.rollouts.inside(known)).sum()),
        "best_logged_return": bar,
        "played_return_mean": float(finite.mean()),
        "kept_return_min": float(returns.min()),
        "kept_return_mean": float(returns.mean()),
        "kept_return_max": float(returns.max()),
        "warnings": [],
    }
    if kept.passes < wanted:
        report["warnings"].append(
            f"rollouts: {passed} of {len(kept.returns):,} imagined episodes pass, which is to earn more than the "
            f"best logged one ({bar:.4g}), so {wanted - kept.passes} of the others are learned from, too; train the "
            "models longer (behaviour.steps, dynamics.epochs) or raise max_rounds"
        )
    if report["kept_outside"] > MOST_OUTSIDE * wanted:
        report["warnings"].append(
            f"rollouts: {report['kept_outside']} of the {wanted} episodes that are learned from leave the range of the "
            "logged states, where nobody knows what follows; train the dynamics longer (dynamics.epochs), or keep them "
            "in there (within_log=True)"
        )
    if returns.max() > possible:
        report["warnings"].append(
            f"rollouts: an imagined episode earns {returns.max():.4g}, more than {steps} of the largest logged rewards "
            f"({possible:.4g}), and the policy is asked for that; the dynamics dream: train them longer, or log more"
        )
    if spec.ever_terminates:
        report["warnings"].append(
            "rollouts: logged episodes end before their time, imagined ones do not, so what follows an end is dreamt; "
            "take a learner with critics for such a log"
        )
    return report
