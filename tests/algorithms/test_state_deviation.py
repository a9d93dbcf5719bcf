"""SDC's term against NumPy: every draw of a next state by itself, every pair of the discrepancy by itself."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import dynamics as predict
from golden import tiny
from golden.networks import act, numbers
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import StateDeviation
from odaf.algorithms.terms.state_deviation import DeviationState
from odaf.components.dynamics import DynamicsConfig
from odaf.components.dynamics.cvae import CVAEDynamics
from odaf.components.dynamics.gaussian_ensemble import GaussianEnsembleDynamics
from odaf.components.trained import Trained
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError
from odaf.runs import presets

KEY = 5
SIZES = {"hidden_sizes": (5, 4), "members": 3, "elites": 3, "latent_dim": 3, "steps": 3}
TERM = StateDeviation(
    weight=2.0,
    state_noise=0.3,
    num_draws=3,
    threshold=0.1,
    multiplier_learning_rate=1e-2,
    dynamics=DynamicsConfig(kind="ensemble", **SIZES),
    transitions=DynamicsConfig(kind="cvae", encoder="transition", **SIZES),
)


def _state(term: StateDeviation) -> DeviationState:
    """Models with random parameters and a multiplier of a half."""
    structure = eqx.filter_eval_shape(lambda: term.init(term.untrained(jr.key(0), tiny.SPEC)))
    filled = tiny.filled(structure, 4)
    dual = Trained(tiny.floats(np.log(0.5)), None, tiny.filled(structure.log_multiplier.moments, size=0.0))
    return dataclasses.replace(filled, log_multiplier=dual)


def _discrepancy(x, y, width: float) -> float:
    """Of two lists of points: the root of the mean likeness within each less twice that between them."""

    def likeness(one, other) -> float:
        return float(np.mean([np.exp(-np.sum((a - b) ** 2) / (2.0 * width)) for a in one for b in other]))

    return np.sqrt(likeness(x, x) + likeness(y, y) - 2.0 * likeness(x, y) + 1e-6)


def _mean(actor, state, batch, term, normals, members) -> float:
    """Mean MMD over the rows. Actions are those of the state beside; what followed in the log, of the state itself."""
    beside = numbers(batch.observations) + term.state_noise * normals[0]
    outcomes, logged = [], []
    rows, draws = len(beside), term.num_draws
    for draw in range(draws):
        actions, _ = act(actor, beside, normals[1][draw])
        noise = (np.full(rows, members[0][draw]), normals[2][draw]) if term.dynamics.kind == "ensemble" else ()
        outcomes.append(predict.PREDICT[term.dynamics.kind](state.dynamics, beside, actions, noise))
        latent = np.reshape(normals[-1], (draws, rows, -1))[draw]
        logged.append(predict.cvae(state.transitions, batch.observations, np.zeros((rows, 0)), latent))
    width = tiny.OBS_DIM if term.kernel_width is None else term.kernel_width
    by_row = [_discrepancy([x[row] for x in outcomes], [y[row] for y in logged], width) for row in range(rows)]
    return float(np.mean(by_row))


@pytest.mark.parametrize("kind", ["ensemble", "deterministic"])
def test_the_loss_follows_its_formula_and_its_gradient_reaches_the_actor_alone(kind):
    term = TERM
    if kind == "deterministic":
        term = dataclasses.replace(TERM, kernel_width=1.7, dynamics=DynamicsConfig(kind="deterministic", **SIZES))
    with tiny.exactly():
        context = tiny.context_of(tiny.state_of(EnsembleSAC(**tiny.SMALL)), tiny.batch())
        state = _state(term)
        with tiny.recorded() as normals, tiny.recorded("randint") as members:
            loss, metrics = term.actor_loss(context, state, jr.key(KEY))

        def expected(actor):
            return 2.0 * 0.5 * (_mean(actor, state, context.batch, term, normals, members) - 0.1)

        np.testing.assert_allclose(loss, expected(context.actor), rtol=1e-9)
        np.testing.assert_allclose(metrics["state_deviation/discrepancy"], loss + 0.1, rtol=1e-9)
        by_context, by_state = eqx.filter_grad(lambda both: term.actor_loss(both[0], both[1], jr.key(KEY))[0])(
            (context, state)
        )
        tiny.assert_slopes(by_context.actor, expected, context.actor)
        assert tiny.all_zero(by_state)
        for name in ("critics", "slow_actor", "target_critics"):
            assert tiny.all_zero(getattr(by_context, name)), name


def test_the_multiplier_climbs_above_the_threshold_and_falls_below_it():
    with tiny.exactly():
        state = _state(TERM)
        for found, way in ((0.3, 1.0), (0.05, -1.0)):
            after = TERM.next_state(state, jnp.asarray(1), {"state_deviation/discrepancy": tiny.floats(found)})
            np.testing.assert_allclose(after.log_multiplier.now, np.log(0.5) + way * 1e-2, rtol=1e-6)
            tiny.assert_same_bits((after.dynamics, after.transitions), (state.dynamics, state.transitions))


def test_pretraining_fits_both_models_and_the_one_of_the_log_sees_no_action():
    dataset = tiny.linear_dataset(episodes=4, length=10)
    calls = []
    models, report = TERM.pretrain(
        dataset, Normaliser.fit(dataset.observations), jr.key(0), lambda *call: calls.append(call)
    )
    blank = jax.eval_shape(lambda: TERM.untrained(jr.key(1), dataset.spec()))
    assert jax.tree.structure(models) == jax.tree.structure(blank)
    assert calls == [("dynamics model", 3, 3), ("transitions model", 3, 3)]
    dynamics, transitions = models
    assert isinstance(dynamics, GaussianEnsembleDynamics) and isinstance(transitions, CVAEDynamics)
    assert dynamics.network.weights[0].shape[1] == tiny.OBS_DIM + tiny.ACT_DIM
    assert transitions.cvae.decoder.weights[0].shape[0] == tiny.OBS_DIM + 3
    for field in ("dynamics", "transitions"):
        assert report[field]["holdout_rows"] == 10
        assert {"holdout_mse", "error_ratio"} <= report[field].keys()
    assert all("state_deviation" in warning for warning in report["warnings"])


def test_the_preset_is_a_conservative_base_with_this_term():
    learner = presets.load("sdc")
    assert [term.name for term in learner.terms] == ["conservative", "state_deviation"]
    assert learner.num_critics == 2 and not learner.entropy_in_backup
    conservative, deviation = learner.terms
    assert conservative.weight == 5.0 and deviation == StateDeviation()
    assert (deviation.state_noise, deviation.threshold, deviation.num_draws) == (1e-3, 0.05, 4)
    assert (deviation.dynamics.kind, deviation.dynamics.members, deviation.dynamics.elites) == ("ensemble", 7, 5)
    assert (deviation.transitions.kind, deviation.transitions.encoder) == ("cvae", "transition")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("weight", -1.0),
        ("state_noise", -1.0),
        ("num_draws", 0),
        ("kernel_width", 0.0),
        ("initial_multiplier", 0.0),
    ],
)
def test_settings_that_make_no_sense_are_refused(field, value):
    with pytest.raises(ConfigError, match=f"state_deviation.{field}={value}"):
        StateDeviation(**{field: value})
