"""Our learners in the state that d3rlpy's export describes, one update on its batch, and what came of it.

What is compared is `update` itself, as training calls it: losses are read off its metrics, gradients off Adam's first
moments, which one step from zero leaves at a tenth of the gradient, and slow copies off the state.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from benchmarks.parity.settings import ROWS, for_losses
from benchmarks.parity.weights import Arrays, network, part, stack
from odaf.algorithms import bcq, bear, behaviour_cloning, cql, iql
from odaf.algorithms.twin_delayed import TwinDelayedState
from odaf.components.behaviour_models import LOG_STD_RANGE, BehaviourCVAE
from odaf.components.cvae import CVAE
from odaf.components.policies import DeterministicActor, ExactGaussianActor, GaussianActor, UnsquashedGaussianActor
from odaf.components.trained import Trained
from odaf.data.transitions import Transitions
from odaf.runs import presets

FIRST_MOMENT = 0.1  # what one step of Adam leaves of a gradient in its first moments


@dataclasses.dataclass(frozen=True)
class Both:
    """Numbers of either side by name, in one layout: losses, gradients and slow copies."""

    ours: dict[str, np.ndarray]
    theirs: dict[str, np.ndarray]


@contextlib.contextmanager
def given(arrays: Sequence[Any]) -> Iterator[None]:
    """While it lasts, `jax.random.normal` and `uniform` return these, one after another.

    Raises:
        AssertionError: an array has another shape than is asked for, or some are left over.
    """
    left = list(arrays)

    def drawn(key: Any, shape: Sequence[int] = (), *_: Any, **__: Any) -> Any:
        del key
        array = jnp.asarray(left.pop(0))
        assert array.shape == tuple(shape), f"asked for {tuple(shape)}, given {array.shape}"
        return array

    before = jr.normal, jr.uniform
    jr.normal = jr.uniform = drawn
    try:
        yield
    finally:
        jr.normal, jr.uniform = before
    assert not left, f"{len(left)} arrays of random numbers were not asked for"


def compared(name: str, export: Arrays) -> Both:
    """Losses, gradients and slow copies of both sides after one update from the export's weights."""
    with jax.numpy_rank_promotion("allow"):
        return COMPARISONS[name](export)


def _learner(name: str, **changes: Any) -> Any:
    return presets.load(name, for_losses(name) | changes)


def _batch(export: Arrays, **extras: Any) -> Transitions:
    rows = {key: jnp.asarray(value) for key, value in part(export, "batch").items()}
    return Transitions(
        rows["observations"],
        rows["actions"],
        rows["rewards"][:, 0],
        rows["next_observations"],
        rows["terminals"][:, 0],
        {key: rows[value] if isinstance(value, str) else value for key, value in extras.items()},
    )


def _gradient(trained: Trained[Any]) -> Any:
    moments: Any = trained.moments
    return jax.tree.map(lambda moment: moment / FIRST_MOMENT, moments[0].mu)


def _numbers(prefix: str, tree: Any) -> dict[str, np.ndarray]:
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {f"{prefix}{jax.tree_util.keystr(path)}": np.asarray(leaf) for path, leaf in leaves}


def _update(learner: Any, state: Any, batch: Transitions, noise: Sequence[Any] = ()) -> tuple[Any, dict[str, Any]]:
    with given(noise):
        return eqx.filter_jit(lambda state, batch: learner.update(state, batch, jr.key(0)))(state, batch)


def _behaviour_cloning(export: Arrays) -> Both:
    before, slope = part(export, "weights"), part(export, "gradient")
    actor = DeterministicActor(network(before, "imitator"))
    state = behaviour_cloning.CloningState(jnp.asarray(0), Trained.begin(actor, slow=False))
    state, metrics = _update(_learner("behaviour-cloning"), state, _batch(export))
    return Both(
        {"loss actor": metrics["actor/loss"]} | _numbers("gradient actor", _gradient(state.actor)),
        {"loss actor": export["loss/loss"]}
        | _numbers("gradient actor", DeterministicActor(network(slope, "imitator"))),
    )


def _twin_delayed(name: str, **extras: Any) -> Callable[[Arrays], Both]:
    def compare(export: Arrays) -> Both:
        before, slope, after = (part(export, key) for key in ("weights", "gradient", "after"))
        actor, critics = DeterministicActor(network(before, "policy")), stack(before, "q_funcs")
        state = TwinDelayedState.begin(actor, critics, ("actor/loss", *CLONING[name], "actor/value"))
        learner = _learner(name)
        state = dataclasses.replace(
            state,
            step=jnp.asarray(learner.actor_delay - 1),  # the actor is due
            actor=dataclasses.replace(state.actor, slow=DeterministicActor(network(before, "targ_policy"))),
            critics=dataclasses.replace(state.critics, slow=stack(before, "targ_q_funcs")),
        )
        state, metrics = _update(learner, state, _batch(export, **extras), [export["noise/0"]])
        ours = {
            "loss critics": metrics["critic/loss"],
            "loss actor": metrics["actor/loss"],
            "loss actor's cloning": metrics[CLONING[name][0]],
            **_numbers("gradient critics", _gradient(state.critics)),
            **_numbers("gradient actor", _gradient(state.actor)),
            **_numbers("slow critics", state.critics.slow),
            **_numbers("slow actor", state.actor.slow),
        }
        theirs = {
            "loss critics": export["loss/critic_loss"],
            "loss actor": export["loss/actor_loss"],
            "loss actor's cloning": export["loss/bc_loss"],
            **_numbers("gradient critics", stack(slope, "q_funcs")),
            **_numbers("gradient actor", DeterministicActor(network(slope, "policy"))),
            **_numbers("slow critics", stack(after, "targ_q_funcs")),
            **_numbers("slow actor", DeterministicActor(network(after, "targ_policy"))),
        }
        return Both(ours, theirs)

    return compare


CLONING = {"td3-bc": ("actor/cloning",), "rebrac": ("actor/distance",)}


def _iql(export: Arrays) -> Both:
    before, slope, after = (part(export, key) for key in ("weights", "gradient", "after"))
    # Theirs is log std = -5 + 7 sigmoid(x) of a parameter x, so that its slope is ours times 7 sigmoid (1 - sigmoid).
    share = 1.0 / (1.0 + np.exp(-before["policy._logstd"][0]))
    actor = UnsquashedGaussianActor(network(before, "policy", ("_mu",)), jnp.asarray(-5.0 + 7.0 * share))
    critics = Trained.begin(stack(before, "q_funcs"))
    state = iql.IQLState(
        step=jnp.asarray(0),
        actor=Trained.begin(actor, slow=False),
        value=Trained.begin(network(before, "value_func"), slow=False),
        critics=dataclasses.replace(critics, slow=stack(before, "targ_q_funcs")),
        reward_scale=jnp.ones(()),
    )
    state, metrics = _update(_learner("iql", reward_scale=1.0), state, _batch(export))
    ours = {
        "loss value": metrics["value/loss"],
        "loss critics": metrics["critic/loss"],
        "loss actor": metrics["actor/loss"],
        **_numbers("gradient value", _gradient(state.value)),
        **_numbers("gradient critics", _gradient(state.critics)),
        **_numbers("gradient actor", _gradient(state.actor)),
        **_numbers("slow critics", state.critics.slow),
    }
    log_std = slope["policy._logstd"][0] / (7.0 * share * (1.0 - share))
    theirs = {
        "loss value": export["loss/v_loss"],
        "loss critics": export["loss/q_loss"],
        "loss actor": export["loss/actor_loss"],
        **_numbers("gradient value", network(slope, "value_func")),
        **_numbers("gradient critics", stack(slope, "q_funcs")),
        **_numbers("gradient actor", UnsquashedGaussianActor(network(slope, "policy", ("_mu",)), jnp.asarray(log_std))),
        **_numbers("slow critics", stack(after, "targ_q_funcs")),
    }
    return Both(ours, theirs)


def _squashed_actor(arrays: Arrays) -> Any:
    return network(arrays, "policy", ("_mu", "_logstd"))


def _scalar(arrays: Arrays, name: str) -> Any:
    return jnp.asarray(arrays[f"{name}._parameter"][0, 0])


def _by_draw(array: np.ndarray, draws: int) -> np.ndarray:
    """Theirs are rows times draws side by side, ours have the draws first."""
    return np.swapaxes(array.reshape(-1, draws, array.shape[-1]), 0, 1)


def _cql(export: Arrays) -> Both:
    before, slope, after = (part(export, key) for key in ("weights", "gradient", "after"))
    learner = _learner("cql")
    critics = Trained.begin(stack(before, "q_funcs"))

    def actor(arrays: Arrays) -> ExactGaussianActor:
        return ExactGaussianActor(_squashed_actor(arrays), None, None, cql.LOG_STD_MIN, cql.LOG_STD_MAX)

    state = cql.CQLState(
        step=jnp.asarray(0),
        actor=Trained.begin(actor(before), slow=False),
        critics=dataclasses.replace(critics, slow=stack(before, "targ_q_funcs")),
        log_temperature=Trained.begin(_scalar(before, "log_temp"), slow=False),
        log_multiplier=Trained.begin(_scalar(before, "log_alpha"), slow=False),
        reward_scale=jnp.ones(()),
    )
    here, following, uniform, of_actor = (export[f"noise/{number}"] for number in range(4))
    action_at_the_mode = np.zeros((1, *of_actor.shape), np.float32)  # of the target
    noise = [of_actor, action_at_the_mode, _by_draw(uniform, learner.num_actions), here, following]
    state, metrics = _update(learner, state, _batch(export), noise)
    penalty = _gradient(state.log_multiplier)  # minus eta times the mean of both critics' penalties
    temperature = np.exp(before["log_temp._parameter"][0, 0])
    ours = {
        "loss critics": metrics["critic/loss"] - 2.0 * penalty,
        "loss actor": metrics["actor/loss"],
        "gradient temperature": _gradient(state.log_temperature),
        "gradient multiplier": penalty,
        **_numbers("gradient critics", _gradient(state.critics)),
        **_numbers("gradient actor", _gradient(state.actor)),
        **_numbers("slow critics", state.critics.slow),
    }
    theirs = {
        "loss critics": export["loss/critic_loss"],
        "loss actor": export["loss/actor_loss"],
        "gradient temperature": np.asarray(_scalar(slope, "log_temp")) / temperature,
        "gradient multiplier": np.asarray(_scalar(slope, "log_alpha")),
        **_numbers("gradient critics", stack(slope, "q_funcs")),
        **_numbers("gradient actor", actor(slope)),
        **_numbers("slow critics", stack(after, "targ_q_funcs")),
    }
    return Both(ours, theirs)


def _behaviour(arrays: Arrays) -> BehaviourCVAE:
    encoder, decoder = network(arrays, "vae_encoder", ("_mu", "_logstd")), network(arrays, "vae_decoder")
    return BehaviourCVAE(CVAE(encoder, decoder, log_std_range=LOG_STD_RANGE))


def _bcq(export: Arrays) -> Both:
    before, slope, after = (part(export, key) for key in ("weights", "gradient", "after"))
    learner = _learner("bcq")
    critics = Trained.begin(stack(before, "q_funcs"))
    perturbation = Trained.begin(network(before, "policy"))
    state = bcq.BCQState(
        step=jnp.asarray(0),
        behaviour=Trained.begin(_behaviour(before), slow=False),
        critics=dataclasses.replace(critics, slow=stack(before, "targ_q_funcs")),
        perturbation=dataclasses.replace(perturbation, slow=network(before, "targ_policy")),
    )
    of_model, of_target, of_actor = (export[f"noise/{number}"] for number in range(3))
    noise = [of_model, _by_draw(of_target, learner.num_actions), of_actor]
    state, metrics = _update(learner, state, _batch(export), noise)
    ours = {
        "loss auto-encoder": metrics["behaviour/loss"],
        "loss critics": metrics["critic/loss"],
        "loss perturbation": metrics["actor/loss"],
        **_numbers("gradient auto-encoder", _gradient(state.behaviour)),
        **_numbers("gradient critics", _gradient(state.critics)),
        **_numbers("gradient perturbation", _gradient(state.perturbation)),
        **_numbers("slow critics", state.critics.slow),
        **_numbers("slow perturbation", state.perturbation.slow),
    }
    theirs = {
        "loss auto-encoder": export["loss/vae_loss"],
        "loss critics": export["loss/critic_loss"],
        "loss perturbation": export["loss/actor_loss"],
        **_numbers("gradient auto-encoder", _behaviour(slope)),
        **_numbers("gradient critics", stack(slope, "q_funcs")),
        **_numbers("gradient perturbation", network(slope, "policy")),
        **_numbers("slow critics", stack(after, "targ_q_funcs")),
        **_numbers("slow perturbation", network(after, "targ_policy")),
    }
    return Both(ours, theirs)


def _bear(export: Arrays) -> Both:
    before, slope, after = (part(export, key) for key in ("weights", "gradient", "after"))
    learner = _learner("bear")
    critics = Trained.begin(stack(before, "q_funcs"))
    state = bear.BEARState(
        step=jnp.asarray(1),  # after the warm-up
        behaviour=Trained.begin(_behaviour(before), slow=False),
        actor=Trained.begin(GaussianActor(_squashed_actor(before)), slow=False),
        critics=dataclasses.replace(critics, slow=stack(before, "targ_q_funcs")),
        log_weight=Trained.begin(_scalar(before, "log_alpha"), slow=False),
    )
    of_model, of_target, _, of_decoder, of_actor = (export[f"noise/{number}"] for number in range(5))
    decoded = of_decoder.reshape(learner.num_draws, ROWS, -1)
    state, metrics = _update(learner, state, _batch(export), [of_model, of_target, of_actor, decoded])
    ours = {
        "loss auto-encoder": metrics["behaviour/loss"],
        "loss critics": metrics["critic/loss"],
        "loss actor": metrics["actor/loss"],
        "gradient multiplier": _gradient(state.log_weight),
        **_numbers("gradient auto-encoder", _gradient(state.behaviour)),
        **_numbers("gradient critics", _gradient(state.critics)),
        **_numbers("gradient actor", _gradient(state.actor)),
        **_numbers("slow critics", state.critics.slow),
    }
    theirs = {
        "loss auto-encoder": export["loss/imitator_loss"],
        "loss critics": export["loss/critic_loss"],
        "loss actor": export["loss/actor_loss"],
        "gradient multiplier": np.asarray(_scalar(slope, "log_alpha")),
        **_numbers("gradient auto-encoder", _behaviour(slope)),
        **_numbers("gradient critics", stack(slope, "q_funcs")),
        **_numbers("gradient actor", GaussianActor(_squashed_actor(slope))),
        **_numbers("slow critics", stack(after, "targ_q_funcs")),
    }
    return Both(ours, theirs)


COMPARISONS: Mapping[str, Callable[[Arrays], Both]] = {
    "behaviour-cloning": _behaviour_cloning,
    "td3-bc": _twin_delayed("td3-bc"),
    "cql": _cql,
    "bcq": _bcq,
    "bear": _bear,
    "iql": _iql,
    "rebrac": _twin_delayed("rebrac", next_actions="next_actions", followed=jnp.ones(ROWS)),
}
