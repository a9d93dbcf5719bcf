"""Making a guard: what a run and its log give, and the calibration on episodes set aside.

In this order: the learner's own critics and dynamics are taken, or fitted to the training log; a fifth of its episodes
gives the levels of the parts and the spread of the dynamics' errors, the others the reference rows; the largest score
of each episode set aside gives the threshold (`odaf.deployment.conformal`).
"""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.dynamics import DynamicsModel
from odaf.components.fitting import Batch, Progress, of_rows
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import scale_actions
from odaf.deployment.conformal import calibrate, pieces
from odaf.deployment.guard import REACTIONS, GuardedPolicy, Reaction
from odaf.deployment.ingredients import GuardSettings, Ingredients, ingredients
from odaf.deployment.nearest import references, whitening
from odaf.deployment.score import PARTS, GuardScore
from odaf.errors import ConfigError, DatasetError
from odaf.estimation.compatibility import require_same_columns
from odaf.training.data_search import check_same_data, find_data
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory

LEVEL_SHARE = 0.2  # of the training log's episodes that the parts' levels are taken from
CONSTANT_WIDTH = 1e-3  # half width of a column that never varied, beside its value
SMALLEST = 1e-6  # of a level or a half width
ERROR_FLOOR = 1e-6  # of the variance of the dynamics' errors


def guard(
    run: Policy | str | os.PathLike[str],
    holdout: Dataset | str | os.PathLike[str],
    *,
    log: Dataset | str | os.PathLike[str] | None = None,
    false_alarms: float = 0.01,
    reaction: Reaction = "warn",
    episode_steps: int | None = None,
    training_seed: int | None = None,
    step: int | None = None,
    seed: int = 0,
    settings: GuardSettings | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> GuardedPolicy:
    """A policy with a guard whose rate of false alarms, by episode, is promised.

    Args:
        run: a run's directory, a policy or the file of one.
        holdout: episodes that the policy did not learn from, such as `odaf data split` sets aside.
        log: what it learned from; None takes the run's own data.
        false_alarms: the most sound episodes that may have an alarm, as a share.
        reaction: what is done in a step with an alarm; see `odaf.deployment.guard.REACTIONS`.
        episode_steps: rows of a recording that count as one episode, for long recordings without ends; None takes
            recordings as they are. Pieces of one recording are alike, so the promise then holds for more of the same.
        training_seed: of a run, whose policy to guard; None the first.
        step: of a run, the checkpoint after so many updates; None the last.
        seed: of everything random.
        settings: sizes of what is fitted.
        progress: called with (steps done, steps in all).
        **changes: fields of `GuardSettings` by name; they go before those in `settings`.

    Raises:
        ConfigError: an argument is out of range, the policy remembers earlier steps, or nobody says what it learned
            from.
        DatasetError: policy and data do not fit, the episodes set aside are too few for the rate, or the policy
            learned from some of them.
        CheckpointError: there is no run, policy or checkpoint.
        DivergenceError: a fit stopped being finite.
    """
    (made,) = guards(
        run,
        holdout,
        (false_alarms,),
        log=log,
        reaction=reaction,
        episode_steps=episode_steps,
        training_seed=training_seed,
        step=step,
        seed=seed,
        settings=settings,
        progress=progress,
        **changes,
    )
    return made


def guards(
    run: Policy | str | os.PathLike[str],
    holdout: Dataset | str | os.PathLike[str],
    rates: Sequence[float],
    *,
    log: Dataset | str | os.PathLike[str] | None = None,
    reaction: Reaction = "warn",
    episode_steps: int | None = None,
    training_seed: int | None = None,
    step: int | None = None,
    seed: int = 0,
    settings: GuardSettings | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> tuple[GuardedPolicy, ...]:
    """A guard for each of several rates of false alarms; what they are made of is fitted once. Else as `guard`."""
    unknown = set(changes) - {field.name for field in dataclasses.fields(GuardSettings)}
    if unknown:
        known = ", ".join(field.name for field in dataclasses.fields(GuardSettings))
        raise ConfigError(f"{sorted(unknown)[0]}: is no setting of a guard; there are {known}")
    if reaction not in REACTIONS:
        raise ConfigError(f"reaction={reaction!r} is none of {', '.join(REACTIONS)}")
    settings = GuardSettings(**{**(vars(settings) if settings is not None else {}), **changes})
    policy, state, directory = _policy_of(run, training_seed, step)
    aside = holdout if isinstance(holdout, Dataset) else Dataset.load(holdout)
    learned = log_of(run if directory is None else directory, log)
    _require_fit(policy, aside)
    _require_fit(policy, learned)
    _require_apart(learned, aside)
    starts = pieces(aside.episode_starts, len(aside), episode_steps)
    lengths = np.diff(np.append(starts, len(aside)))
    for rate in rates:  # before anything is fitted
        calibrate(np.zeros(len(starts)), rate, lengths)

    keys = jr.split(jr.key(seed), 4)
    made = ingredients(
        policy, state, learned, reaction == "clone", settings, keys[:3], progress or (lambda done, total: None)
    )
    warnings = made.said.pop("warnings")
    score, usual = _score_of(policy, learned, made, episode_steps, settings, keys[3])
    logged, own = (np.maximum.reduceat(parts_of(score, policy, aside, own=own), starts) for own in (False, True))
    facts = {
        **made.said,
        "notes": [*warnings, *_notes(episode_steps)],
        "holdout_sha256": aside.fingerprint(),
        "log_sha256": learned.fingerprint(),
        "policy": dict(policy.provenance),
        "seed": seed,
        "settings": vars(settings),
    }
    found = []
    for rate in rates:
        levels = np.maximum(np.quantile(usual, 1.0 - rate, axis=0), SMALLEST).astype(np.float32)
        calibration = calibrate((logged / levels).max(axis=1), rate, lengths, episode_steps)
        above = logged / levels > calibration.threshold
        counts = {
            "alarms": int(above.any(axis=1).sum()),
            "alarms_by_part": dict(zip(PARTS, above.sum(axis=0).tolist(), strict=True)),
            "policy_alarms": int((~((own / levels).max(axis=1) <= calibration.threshold)).sum()),
        }
        levelled = dataclasses.replace(score, levels=jnp.asarray(levels))
        found.append(GuardedPolicy(policy, levelled, calibration, reaction, made.clone, counts | facts))
    return tuple(found)


def parts_of(score: GuardScore, policy: Policy, dataset: Dataset, *, own: bool = False) -> np.ndarray:
    """[N, parts] of every row of a log, beside their levels: of the logged actions, or of the policy's own.

    The step before is the logged one in both cases.
    """
    states, actions, before = _columns(policy, dataset)
    if own:
        actions = jnp.asarray(of_rows(_modes, policy.actor, (states,)))
    return of_rows(_parts, (score, policy.actor), (jnp.asarray(dataset.observations), actions, *before))


def _parts(model: tuple[GuardScore, Actor], batch: Batch) -> Float[Array, "rows parts"]:
    score, actor = model
    observations, actions, *before = batch
    return score.judge(actor, observations, actions, (before[0], before[1])).parts


def _modes(actor: Actor, batch: Batch) -> Float[Array, "rows act_dim"]:
    return actor.mode(batch[0])


def _expected(outcome: DynamicsModel, batch: Batch) -> Float[Array, "rows obs_dim"]:
    return outcome.expected(batch[0], batch[1])


def _columns(policy: Policy, dataset: Dataset) -> tuple[Array, Array, tuple[Array, Array]]:
    """Normalised observations, actions in [-1, 1], and both of the step before, NaN in the first of an episode."""
    states = jnp.asarray(policy.normaliser.normalise(dataset.observations), jnp.float32)
    scaled = scale_actions(dataset.actions, policy.action_low, policy.action_high)
    actions = jnp.clip(jnp.asarray(scaled, jnp.float32), -1.0, 1.0)
    first = jnp.asarray(dataset.episode_starts)
    state, action = (jnp.roll(column, 1, axis=0).at[first].set(jnp.nan) for column in (states, actions))
    return states, actions, (state, action)


def _score_of(
    policy: Policy,
    log: Dataset,
    made: Ingredients,
    episode_steps: int | None,
    settings: GuardSettings,
    key: PRNGKeyArray,
) -> tuple[GuardScore, np.ndarray]:
    """The score, whose levels are 1, and the largest parts [episodes, parts] in the episodes kept for levels."""
    rng = np.random.default_rng(np.asarray(jr.bits(key, (4,))))
    starts = pieces(log.episode_starts, len(log), episode_steps)
    chosen = np.sort(rng.permutation(len(starts))[: max(round(LEVEL_SHARE * len(starts)), 1)])
    for_levels = np.isin(np.searchsorted(starts, np.arange(len(log)), side="right") - 1, chosen)
    for_points = ~for_levels if len(starts) > 1 else for_levels

    states, actions, before = _columns(policy, log)
    rows = np.concatenate([np.asarray(states), np.asarray(actions)], axis=1)
    white = whitening(rows[for_points])
    places = (rows[for_points] @ white).astype(np.float32)
    errors = np.asarray(states) - of_rows(_expected, made.outcome, before)
    errors = errors[for_levels & np.isfinite(errors).all(axis=1)]
    low, high = log.observations.min(axis=0).astype(np.float64), log.observations.max(axis=0).astype(np.float64)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    constant = list(policy.normaliser.constant)
    half[constant] = CONSTANT_WIDTH * np.abs(centre[constant])
    score = GuardScore(
        outcome=made.outcome,
        critics=made.critics,
        mean=jnp.asarray(policy.normaliser.shift),
        inverse_scale=jnp.asarray(1.0 / policy.normaliser.scale, jnp.float32),
        centre=jnp.asarray(centre, jnp.float32),
        half_width=jnp.asarray(np.maximum(half, SMALLEST), jnp.float32),
        whitening=jnp.asarray(white, jnp.float32),
        points=jnp.asarray(places[references(places, settings.references, rng)]),
        error_whitening=jnp.asarray(whitening(errors, ERROR_FLOOR), jnp.float32),
        levels=jnp.ones(len(PARTS), jnp.float32),
    )
    seen = jnp.asarray(log.observations), actions, *before
    parts = of_rows(_parts, (score, policy.actor), tuple(column[for_levels] for column in seen))
    return score, np.maximum.reduceat(parts, np.searchsorted(np.flatnonzero(for_levels), starts[chosen]))


# ---- where it comes from ----------------------------------------------------------------------------------------


def _policy_of(
    run: Policy | str | os.PathLike[str], seed: int | None, step: int | None
) -> tuple[Policy, tuple[Any, Any] | None, RunDirectory | None]:
    """The policy; of a run its learner with its state, and the directory."""
    if isinstance(run, Policy) or Path(run).is_file():
        if seed is not None or step is not None:
            raise ConfigError("training_seed=, step=: choose a policy of a run; leave them out for a single policy")
        return (run if isinstance(run, Policy) else Policy.load(run)), None, None
    directory = RunDirectory(Path(run))
    chosen = directory.seeds[0] if seed is None else seed
    checkpoint = directory.checkpoint(chosen, step)
    state = directory.state(chosen, checkpoint.step)
    return directory.policy_of(state, seed=chosen, step=checkpoint.step), (directory.algorithm, state), directory


def log_of(
    run: Policy | str | os.PathLike[str] | RunDirectory, log: Dataset | str | os.PathLike[str] | None
) -> Dataset:
    """What a policy learned from: as given, or the data of its run.

    Raises:
        ConfigError: nobody says what that is.
        DatasetError: it is not there any more, or what was given is something else.
    """
    if isinstance(log, Dataset):
        return log
    directory = run if isinstance(run, RunDirectory) else None
    if isinstance(run, str | os.PathLike) and Path(run).is_dir():
        directory = RunDirectory(Path(run))
    if log is not None:
        path = Path(log)
    elif directory is not None:
        path = find_data(directory)
    else:
        raise ConfigError("log=: a single policy does not say where the data are that it learned from; give them")
    dataset = Dataset.load(path)
    if directory is not None:
        check_same_data(directory, dataset, path)
    return dataset


def _require_fit(policy: Policy, dataset: Dataset) -> None:
    if jax.tree.leaves(policy.actor.begin(1)):
        raise ConfigError(
            f"{type(policy.actor).__name__}: remembers earlier steps, and a guard asks what it would do next at states "
            "that were only predicted; take a learner whose policy sees one observation"
        )
    require_same_columns(policy, dataset)


def _require_apart(log: Dataset, holdout: Dataset) -> None:
    """Raises unless no episode set aside is one that the policy learned from."""
    seen = {_print_of(log, index) for index in range(log.num_episodes)}
    shared = [index for index in range(holdout.num_episodes) if _print_of(holdout, index) in seen]
    if shared:
        raise DatasetError(
            f"the policy learned from {len(shared):,} of the {holdout.num_episodes:,} episodes set aside, such as "
            f"episode {shared[0]}, so that no rate of false alarms can be promised; set episodes aside before training "
            "with `odaf data split`"
        )


def _print_of(dataset: Dataset, index: int) -> bytes:
    rows = dataset.episode(index)
    return dataset.observations[rows].tobytes() + dataset.actions[rows].tobytes()


def _notes(episode_steps: int | None) -> list[str]:
    if episode_steps is None:
        return []
    return [
        f"an episode is {episode_steps:,} rows of a recording; pieces of one recording are alike, so the rate holds "
        "for more of the same recordings, and less surely for others"
    ]
