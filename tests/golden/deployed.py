"""Policies with random parameters, in the forms of an artefact, and each form run on one observation after another."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from battery import learners
from odaf.components.networks import init_mlp
from odaf.components.return_conditioned import ReturnConditionedActor
from odaf.data.derived import Derivation
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.training.policy import Policy

# In single precision, half the range and its centre add up to more than 0.3.
LOW, HIGH = (-0.3, 0.0), (0.3, 100.0)


def policy_of(kind: str, obs_dim: int = 4, derivation: Derivation | None = None, seed: int = 0) -> Policy:
    """A small policy of a registered learner whose actions fill their range; its second observation never varied."""
    learner = learners.of_kind(kind)
    if derivation is not None:
        obs_dim = len(derivation.names)
    spec = Spec(obs_dim, len(LOW), LOW, HIGH, -1.0, 1.0, True, 20)
    rng = np.random.default_rng(seed)
    actor = jax.eval_shape(lambda key: learner.actor(learner.init(key, spec, learner.untrained(key, spec))), jr.key(0))
    actor = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), actor)
    names = derivation.names if derivation is not None else tuple(f"x{index}" for index in range(obs_dim))
    normaliser = Normaliser(rng.normal(size=obs_dim), rng.uniform(0.5, 2.0, obs_dim), constant=(1,))
    return Policy(actor, normaliser, LOW, HIGH, names, ("valve", "heat"), (), ("", "%"), derivation=derivation)


def asking(derivation: Derivation | None = None) -> Policy:
    """A policy that is asked for a return of 30."""
    base = policy_of("behaviour-cloning", derivation=derivation)
    rng = np.random.default_rng(1)
    network = jax.eval_shape(lambda: init_mlp(jr.key(0), (base.obs_dim + 1, 8, base.act_dim)))
    network = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), network)
    numbers = (jnp.asarray(number) for number in (30.0, 20.0, 10.0))
    return replace(base, actor=ReturnConditionedActor(network, *numbers))


def remembering(lags: int = 2, differences: bool = True) -> Derivation:
    """Observations of three readings with changes and earlier rows."""
    recipes: list[dict[str, Any]] = [{"recipe": "readings", "columns": ["level", "flow", "temp"]}]
    recipes += [{"recipe": "differences"}] if differences else []
    recipes += [{"recipe": "lags", "rows": lags, "actions": ["valve", "heat"]}] if lags else []
    return Derivation.from_recipes(recipes)


class OnnxPolicy:
    """The ONNX form, one row at a time, with what it remembers."""

    def __init__(self, file: Path):
        import onnxruntime

        self.session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        self.outputs = [entry.name for entry in self.session.get_outputs()]
        self.metadata = self.session.get_modelmeta().custom_metadata_map
        self.carry = {
            entry["name"]: np.array([entry["start"]], np.float32) for entry in json.loads(self.metadata["carries"])
        }

    def act(self, row: Any) -> tuple[np.ndarray, int]:
        """Action and status."""
        found = self.run({"observation": np.asarray(row, np.float32)[None]})
        self.carry = {name: found[f"next_{name}"] for name in self.carry}
        return found["action"][0], int(found["status"][0])

    def run(self, feeds: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Every output for the feeds, and the carry that there is."""
        found: Any = self.session.run(None, {**feeds, **self.carry})
        return dict(zip(self.outputs, found, strict=True))
