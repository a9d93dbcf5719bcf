"""Policies beside a log: what is fitted for all of them, and for the behaviour.

Fitted Q and rollouts of a model judge the behaviour itself too, whose value is known from the log, and that serves
twice. It is the control: where an estimator misses what the log earned, it does not hold for this log. And it
calibrates: to what the log earned is added by how much the estimator puts the policy above the behaviour, member by
member, so that what it gets wrong for both cancels. The model says, too, where the policy comes to, and so how much of
what it earns the log leaves open; the behaviour's own states are the control of that.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import PRNGKeyArray

from odaf.components.fitting import Progress, of_rows
from odaf.components.policies import Actor
from odaf.data.normalisation import Normaliser
from odaf.estimation.compatibility import why_unweighed
from odaf.estimation.density import BehaviourDensity
from odaf.estimation.evidence import Evidence, Stages, draws, modes
from odaf.estimation.fitted_q import FittedQ, fit_q
from odaf.estimation.model import Player, fit_model
from odaf.estimation.of_policy import ByMembers, Judged, OfPolicy
from odaf.estimation.outcomes import KnownOutcomes
from odaf.estimation.settings import Acting
from odaf.estimation.valuation import Valuation
from odaf.training.policy import Policy

DRAWS = 4  # of the policy at each state, where draws are judged


class Beside:
    """Policies beside a log.

    Args:
        policies: to judge; on observations that are computed already.
        log: what they are judged by.
        acting: which of their actions.
        key: for draws of the policies and for what is fitted.
    """

    def __init__(self, policies: Sequence[Policy], log: Evidence, acting: Acting, key: PRNGKeyArray) -> None:
        self.log = log
        self.acting: Acting = acting
        key_actions, self.key_density, self.key_q, self.key_following, self.key_model = jr.split(key, 5)
        self.judged = []
        for number, policy in enumerate(policies):
            here, there = jr.split(jr.fold_in(key_actions, number))
            normalise = policy.normaliser.normalise
            now, later = (
                np.asarray(normalise(part), np.float32)
                for part in (log.dataset.observations, log.dataset.next_observations)
            )
            self.judged.append(
                Judged(
                    policy,
                    self._act(policy.actor, now, here),
                    self._act(policy.actor, later, there),
                    why_unweighed(policy.actor, acting),
                )
            )

    def _act(self, actor: Actor, observations: np.ndarray, key: PRNGKeyArray) -> np.ndarray:
        """[rows, draws, act_dim]; one draw where the mode is judged."""
        columns = (jnp.asarray(observations), jnp.arange(len(observations)))
        if self.acting == "mode":
            return of_rows(modes, actor, columns)[:, None]
        return np.stack([of_rows(draws, (actor, each), columns) for each in jr.split(key, DRAWS)], axis=1)

    def valuations(
        self, methods: tuple[str, ...], log_probs: str | None, progress: Progress
    ) -> list[tuple[Valuation, ...]]:
        """For each policy a valuation at each discount; progress is told as it comes."""
        needed = set(methods) | ({"fqe", "model"} if "blend" in methods else set())
        wants_q = bool({"fqe", "shrunk"} & needed) or (
            "dr" in needed and any(not each.unweighed for each in self.judged)
        )
        stages = Stages(progress, self.log.settings.steps, 1 + wants_q + ("model" in needed))
        density = self.log.fitted_density(self.key_density, stages.next())
        fitted = self._fit(density, stages.next()) if wants_q else []
        model = fit_model(self.log, self.key_model, stages.next()) if "model" in needed else None
        behaviour = Player(density.model, np.zeros(()), np.ones(()), True)
        modelled = None if model is None else model.play(replace(behaviour, **_scaling(self.log.normaliser)))
        outcomes = None if model is None else KnownOutcomes(self.log)
        strays = 0.0 if modelled is None or outcomes is None else outcomes.unknown(modelled.visited)[0].share
        found = []
        for number, judged in enumerate(self.judged):
            known = replace(judged, unlike=density.share_unlike(self.log.actions, judged.actions[:, 0]))
            by_model = unknown = None
            if model is not None and modelled is not None and outcomes is not None:
                player = Player(judged.policy.actor, **_scaling(judged.policy.normaliser), draws=self.acting == "draws")
                played = model.play(player)
                by_model = ByMembers(played.values, modelled.values, {"loss": model.loss, "strays": strays}, strays)
                unknown = outcomes.unknown(played.visited)
            own_q = (fitted[number], fitted[-1]) if wants_q else None
            of_policy = OfPolicy(self.log, self.acting, known, own_q, by_model, unknown, density, log_probs)
            found.append(of_policy.valuations(methods))
        stages.finished()
        return found

    def _fit(self, density: BehaviourDensity, progress: Progress) -> list[FittedQ]:
        """Of every policy, and last of the behaviour."""
        log, settings = self.log, self.log.settings
        following = log.following_actions(density, self.key_following)[:, None]
        everyone = [each.next_actions for each in self.judged]
        everyone.append(np.broadcast_to(following, everyone[0].shape))
        return fit_q(
            log.rows(),
            np.stack(everyone),
            log.member_rows,
            log.horizon,
            log.discounts,
            self.key_q,
            members=settings.members,
            progress=progress,
            held_out=log.held_out,
            patience=settings.patience,
            **settings.fitting(),
        )


def _scaling(normaliser: Normaliser) -> dict[str, np.ndarray]:
    return {"mean": normaliser.shift, "scale": normaliser.scale}
