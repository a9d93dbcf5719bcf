"""Safe and unsafe actions in logged states, where they lead, and what scores say of them.

Safe: an inverse map's action from a state s_i to the recorded successor of a similar state s_j of another episode.
Unsafe: uniform in the bounds. Where both lead is told by the simulator, by the paper's CVAE and by our deterministic
model, which learn from the log.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from odaf.components.dynamics import DynamicsModel
    from odaf.components.fitting import Progress
    from odaf.data.dataset import Dataset
    from odaf.data.normalisation import Normaliser
    from odaf.training.run_directory import RunDirectory

Sides = Mapping[str, np.ndarray]
"""Of the actions in "safe" and in "unsafe", an array each."""

MODELS = ("cvae", "deterministic")
DRAWS = 10  # of the CVAE's latent variable
BINS = 30
RESAMPLES = 2_000


@dataclass(frozen=True)
class Actions:
    """Safe and unsafe actions of equally many states of a log.

    Attributes:
        rows: [pairs] the states, as rows of the log.
        sides: [pairs, act_dim] each, in [-1, 1].
        near: distance in normalised units below which two states are similar.
        inverse_r_squared: of the inverse map on held-out episodes.
    """

    rows: np.ndarray
    sides: Sides
    near: float
    inverse_r_squared: float


def draw_actions(
    dataset: "Dataset",
    normaliser: "Normaliser",
    states: int,
    steps: int,
    hidden: tuple[int, ...],
    seed: int,
    progress: "Progress",
) -> Actions:
    """Finds similar states, fits the inverse map and draws both kinds of action."""
    import jax.numpy as jnp
    import jax.random as jr

    from odaf.evaluation.inverse_map import fit_inverse_map
    from odaf.evaluation.similar_pairs import similar_pairs

    pairs = similar_pairs(dataset, normaliser, states, seed=seed)
    inverse, fit = fit_inverse_map(dataset, normaliser, jr.key(seed), steps, hidden, progress)
    begin = normaliser.normalise(dataset.observations[pairs.rows])
    end = normaliser.normalise(dataset.next_observations[pairs.others])
    safe = np.asarray(inverse(jnp.asarray(begin), jnp.asarray(end)))
    unsafe = np.random.default_rng(seed).uniform(-1.0, 1.0, safe.shape).astype(np.float32)
    return Actions(pairs.rows, {"safe": safe, "unsafe": unsafe}, pairs.threshold, fit)


def fitted_model(
    kind: str,
    dataset: "Dataset",
    normaliser: "Normaliser",
    steps: int,
    hidden: tuple[int, ...],
    seed: int,
    progress: "Progress",
) -> "tuple[DynamicsModel, dict[str, float]]":
    """A model of the dynamics and its one-step error on held-out episodes, in normalised units."""
    import jax.random as jr

    from odaf.components.dynamics import DynamicsConfig, fit_dynamics

    own: dict[str, Any] = {"steps": steps, "hidden_sizes": hidden}
    if kind == "cvae":  # as the paper trains it
        own |= {"kind": "cvae", "residual": False, "learning_rate": 1e-4, "schedule": "constant"}
    model, report = fit_dynamics(DynamicsConfig(**own), dataset, normaliser, jr.key(seed), progress)
    return model, {"normalised_rmse": float(np.sqrt(report["holdout_mse"])), "error_ratio": report["error_ratio"]}


class Outcomes:
    """Where actions lead, in the user's units.

    Args:
        dataset: the log; bodies are those that it recorded, or else those that observations show.
        robot: as in `hopper`.
        rows: the states.
    """

    def __init__(self, dataset: "Dataset", robot: str, rows: np.ndarray):
        from odaf.environments.locomotion import Simulator, task_of

        self._simulator, self._observations = Simulator(task_of(robot)), dataset.observations[rows]
        recorded = "qpos" in dataset.infos and "qvel" in dataset.infos
        parts = (dataset.infos["qpos"][rows], dataset.infos["qvel"][rows]) if recorded else (self._observations,)
        self._bodies = np.concatenate(parts, axis=1).astype(np.float64)

    def true(self, actions: np.ndarray) -> np.ndarray:
        """By the simulator: [rows, obs_dim]."""
        from odaf.evaluation.outcome_score import true_outcomes

        return true_outcomes(self._simulator, self._bodies, actions)

    def modelled(
        self, model: "DynamicsModel", normaliser: "Normaliser", actions: np.ndarray, draws: int, seed: int
    ) -> np.ndarray:
        """By a model: [draws, rows, obs_dim] in normalised units."""
        import jax.random as jr

        from odaf.evaluation.outcome_score import modelled_outcomes

        states = normaliser.normalise(self._observations)
        return modelled_outcomes(model, states, actions, jr.key(seed), draws)


def scores_of(run: "RunDirectory", seed: int, draws: np.ndarray) -> np.ndarray:
    """The outcome's score by a policy and its critics: [rows] of states [draws, rows, obs_dim] in normalised units."""
    import jax.random as jr

    from odaf.components.policies import SquashedGaussianActor
    from odaf.evaluation.outcome_score import outcome_uncertainty
    from odaf.training import averaging

    state = run.state(seed)
    critics = run.algorithm.values(averaging.learner_state(state))
    actor = averaging.deployed_actor(run.algorithm, state)
    assert critics is not None and isinstance(actor, SquashedGaussianActor)
    return np.mean([outcome_uncertainty(critics, actor, each, jr.key(seed)) for each in draws], axis=0)


def without_outcomes(run: "RunDirectory", seed: int, states: np.ndarray, sides: Sides) -> Sides:
    """The critics' disagreement at the actions themselves; `states` in normalised units."""
    from odaf.evaluation.outcome_score import action_uncertainty
    from odaf.training.averaging import learner_state

    critics = run.algorithm.values(learner_state(run.state(seed)))
    assert critics is not None
    return {name: action_uncertainty(critics, states, actions) for name, actions in sides.items()}


def improbable(
    dataset: "Dataset",
    normaliser: "Normaliser",
    states: np.ndarray,
    sides: Sides,
    steps: int,
    hidden: tuple[int, ...],
    seed: int,
    progress: "Progress",
) -> Sides:
    """Minus the log-density of the actions under a clone of whoever wrote the log."""
    import jax.numpy as jnp
    import jax.random as jr

    from odaf.components.behaviour_models import BehaviourConfig, fit_gaussian, log_density_inside

    config = BehaviourConfig(steps=steps, hidden_sizes=hidden)
    model, _ = fit_gaussian(config, dataset, normaliser, jr.key(seed), progress)
    seen = jnp.asarray(states)
    return {name: -np.asarray(log_density_inside(model, seen, jnp.asarray(each))) for name, each in sides.items()}


def told_apart(sides: Sides, seed: int) -> dict[str, Any]:
    """Both means with their 95 % bootstrap intervals, the gap, histograms, and the area under the ROC curve."""
    from odaf.evaluation.outcome_score import area_under_curve
    from odaf.evaluation.statistics import bootstrap_interval

    both = np.concatenate([sides["safe"], sides["unsafe"]])
    edges = np.linspace(float(both.min()), float(np.quantile(both, 0.99)) + 1e-9, BINS + 1)
    found: dict[str, Any] = {
        "auroc": area_under_curve(sides["safe"], sides["unsafe"]),
        "gap": float(sides["unsafe"].mean() - sides["safe"].mean()),
        "edges": [float(edges[0]), float(edges[-1])],
    }
    for name, values in sides.items():
        mean = bootstrap_interval(values.astype(np.float64), seed=seed, resamples=RESAMPLES)
        counts = np.histogram(np.minimum(values, edges[-1]), edges)[0]
        found[name] = {"mean": mean.mean, "interval": [mean.low, mean.high], "histogram": counts.tolist()}
    return found
