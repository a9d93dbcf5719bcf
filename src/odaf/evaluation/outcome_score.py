"""The score of an action by its outcome, and how well a score tells unsafe actions from safe ones.

    score(s, a) = E_{s'} U(s'),   U(s') = E_{a' ~ pi(.|s')} std_k Q_k(s', a')

The square under the root of the standard deviation, which the paper's formula lost, is there.
"""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.critics import CriticEnsemble, disagreement
from odaf.components.dynamics import DynamicsModel
from odaf.components.policies import SquashedGaussianActor
from odaf.environments.locomotion import Simulator


def true_outcomes(simulator: Simulator, bodies: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """What the simulator says an action leads to.

    Args:
        simulator: of the log's robot.
        bodies: [rows, obs_dim or qpos and qvel], as `Simulator.place` takes them.
        actions: [rows, act_dim] in [-1, 1].

    Returns:
        [rows, obs_dim] next observations.
    """
    found = []
    for body, action in zip(bodies, actions, strict=True):
        simulator.place(body)
        found.append(simulator.step(action)[0])
    return np.array(found, np.float32)


def modelled_outcomes(
    model: DynamicsModel, states: np.ndarray, actions: np.ndarray, key: PRNGKeyArray, draws: int = 10
) -> np.ndarray:
    """Draws of a dynamics model: [draws, rows, obs_dim], everything in normalised units."""
    seen, taken = (jnp.broadcast_to(jnp.asarray(each)[None], (draws, *each.shape)) for each in (states, actions))
    return np.asarray(_predict_draws(model, seen, taken, key))


def outcome_uncertainty(
    critics: CriticEnsemble, actor: SquashedGaussianActor, states: np.ndarray, key: PRNGKeyArray, actions: int = 10
) -> np.ndarray:
    """U(s') of states [rows, obs_dim] in normalised units: mean over actions of the policy of std_k Q_k. [rows]."""
    noise = jr.normal(key, (actions, len(states), _act_dim(actor, states)))
    return np.asarray(_uncertainty(critics, actor, jnp.asarray(states), noise))


def action_uncertainty(critics: CriticEnsemble, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """std_k Q_k(s, a) of the action itself, without looking where it leads. [rows]."""
    return np.asarray(_own_uncertainty(critics, jnp.asarray(states), jnp.asarray(actions)))


def area_under_curve(safe: np.ndarray, unsafe: np.ndarray) -> float:
    """Probability that an unsafe action scores above a safe one, ties half: the area under the ROC curve."""
    ranks = _ranks(np.concatenate([safe, unsafe]))[len(safe) :]
    return float((ranks.sum() - len(unsafe) * (len(unsafe) + 1) / 2) / (len(safe) * len(unsafe)))


def rank_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Spearman's: the correlation of the ranks."""
    return float(np.corrcoef(_ranks(first), _ranks(second))[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    from scipy.stats import rankdata

    return rankdata(values)


def _act_dim(actor: SquashedGaussianActor, states: np.ndarray) -> int:
    return eqx.filter_eval_shape(actor.mode, jnp.asarray(states[:1])).shape[1]


@eqx.filter_jit
def _predict_draws(
    model: DynamicsModel,
    states: Float[Array, "draws rows obs_dim"],
    actions: Float[Array, "draws rows act_dim"],
    key: PRNGKeyArray,
) -> Float[Array, "draws rows obs_dim"]:
    return model.predict_draws(states, actions, key)


@eqx.filter_jit
def _uncertainty(
    critics: CriticEnsemble,
    actor: SquashedGaussianActor,
    states: Float[Array, "rows obs_dim"],
    noise: Float[Array, "actions rows act_dim"],
) -> Float[Array, " rows"]:
    found = [disagreement(critics(states, actor.sample(states, each)[0])) for each in noise]
    return jnp.mean(jnp.stack(found), axis=0)


@eqx.filter_jit
def _own_uncertainty(
    critics: CriticEnsemble, states: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
) -> Float[Array, " rows"]:
    return disagreement(critics(states, actions))
