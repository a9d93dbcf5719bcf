"""Policies in files: what comes back, what any reader of the layout sees, which damaged or hostile ones are refused."""

import dataclasses
import hashlib
import json
import os
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from golden import tiny
from odaf.components import stored
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.policies import Actor, GaussianActor, init_deterministic_actor, init_gaussian_actor
from odaf.components.priors import init_priors
from odaf.data.normalisation import Normaliser
from odaf.errors import CheckpointError, ConfigError
from odaf.training.policy import Policy
from odaf.training.tensors import read_tensors, write_tensors


def _policy(obs_dim: int = 3, act_dim: int = 2, hidden=(5,), deterministic: bool = False, seed: int = 0) -> Policy:
    rng = np.random.default_rng(seed)
    init = init_deterministic_actor if deterministic else init_gaussian_actor
    shapes = eqx.filter_eval_shape(init, jr.key(seed), obs_dim, act_dim, hidden)
    return Policy(
        tiny.filled(shapes, seed),
        Normaliser(rng.normal(size=obs_dim), rng.uniform(0.1, 9.0, obs_dim)),
        tuple((-rng.uniform(0.1, 3.0, act_dim)).tolist()),
        tuple(rng.uniform(0.1, 3.0, act_dim).tolist()),
        tuple(f"column {index} °C" for index in range(obs_dim)),
        tuple(f"valve {index}" for index in range(act_dim)),
        ("m³/s",) * obs_dim,
        (),
        {"learner": "tiny", "seed": seed, "preset": None},
    )


def _header(file: Path) -> tuple[dict, bytes]:
    """By hand, as any reader of the layout would: the header and the data."""
    content = file.read_bytes()
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def _write(file: Path, header: dict, data: bytes) -> None:
    text = json.dumps(header).encode()
    file.write_bytes(len(text).to_bytes(8, "little") + text + data)


# ---- round trips ---------------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(
    obs_dim=st.integers(1, 6),
    act_dim=st.integers(1, 4),
    hidden=st.lists(st.integers(1, 7), max_size=2).map(tuple),
    deterministic=st.booleans(),
    seed=st.integers(0, 99),
)
def test_a_policy_of_any_size_comes_back_whole(tmp_path_factory, obs_dim, act_dim, hidden, deterministic, seed):
    file = tmp_path_factory.mktemp("policies") / "policy.safetensors"
    policy = _policy(obs_dim, act_dim, hidden, deterministic, seed)
    policy.save(file)
    found = Policy.load(str(file))
    tiny.assert_same_bits(found.actor, policy.actor)
    assert jax.tree.structure(found.actor) == jax.tree.structure(policy.actor)
    for field in dataclasses.fields(Policy):
        if field.name not in ("actor", "normaliser"):
            assert getattr(found, field.name) == getattr(policy, field.name)
    assert found.normaliser.to_dict() == policy.normaliser.to_dict()
    again = file.with_name("again.safetensors")
    found.save(again)
    assert again.read_bytes() == file.read_bytes()


def test_a_loaded_policy_acts_with_the_same_bits(tmp_path):
    policy, file = _policy(), tmp_path / "policy.safetensors"
    policy.save(file)
    found, rows = Policy.load(file), np.random.default_rng(1).normal(size=(3, 3)).astype(np.float32)
    np.testing.assert_array_equal(found(rows), policy(rows))
    np.testing.assert_array_equal(found.sample(rows, 1), policy.sample(rows, 1))


@settings(max_examples=50)
@given(
    arrays=st.dictionaries(
        st.text(min_size=1).filter(lambda name: name != "__metadata__"),
        st.sampled_from([np.float32, np.float64, np.float16, np.int64, np.uint8, np.bool_]).flatmap(
            lambda kind: hnp.arrays(kind, hnp.array_shapes(min_dims=0, min_side=0, max_side=4))
        ),
        max_size=4,
    ),
    metadata=st.dictionaries(st.text(), st.text(), max_size=3),
)
def test_arrays_of_any_shape_name_and_type_come_back(tmp_path_factory, arrays, metadata):
    file = tmp_path_factory.mktemp("tensors") / "arrays.safetensors"
    write_tensors(file, arrays, metadata)
    found, texts = read_tensors(file)
    assert list(found) == list(arrays) and texts == metadata
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and found[name].shape == array.shape
        assert found[name].tobytes() == array.tobytes()
    header, data = _header(file)
    assert set(header) == {"__metadata__", *arrays} and (file.stat().st_size - len(data)) % 8 == 0


def test_the_file_is_plain_to_any_reader_of_the_layout(tmp_path):
    policy, file = _policy(), tmp_path / "policy.safetensors"
    policy.save(file)
    header, data = _header(file)
    metadata = header.pop("__metadata__")
    assert metadata["format"] == "odaf-policy" and metadata["version"] == "1"
    assert list(header) == [f"actor/network/{part}/{layer}" for part in ("biases", "weights") for layer in (0, 1)]
    assert isinstance(policy.actor, GaussianActor)
    weights = policy.actor.network.weights[1]
    entry = header["actor/network/weights/1"]
    begin, end = entry["data_offsets"]
    assert entry["dtype"] == "F32" and entry["shape"] == [5, 4]
    np.testing.assert_array_equal(np.frombuffer(data[begin:end], "<f4").reshape(5, 4), weights)
    content = json.loads(metadata["policy"])
    assert content["actor"]["kind"] == "gaussian"
    assert content["actor"]["network"] == {
        "kind": "mlp",
        "weights": [{"array": [3, 5]}, {"array": [5, 4]}],
        "biases": [{"array": [5]}, {"array": [4]}],
        "scales": [],
        "offsets": [],
        "activation": "relu",
        "products": "float32",
    }
    assert content["observations"] == {"names": list(policy.observation_names), "units": ["m³/s"] * 3}
    assert content["actions"]["low"] == list(policy.action_low) and content["normaliser"]["epsilon"] == 0.0
    assert metadata["sha256"] == hashlib.sha256(metadata["policy"].encode() + data).hexdigest()


class Best(Actor):
    """The best of two proposals in the eyes of critics."""

    proposals: tuple[Actor, ...]
    critics: CriticEnsemble
    margin: float = eqx.field(static=True, default=0.0)

    def act(self, carry, observations, key=None):
        actions = jnp.stack([actor.mode(observations) for actor in self.proposals])
        values = jnp.stack([jnp.min(self.critics(observations, each), axis=0) for each in actions])
        choice = (values[1] > values[0] + self.margin)[:, None]
        return jnp.where(choice, actions[1], actions[0]), carry


def test_an_actor_made_of_several_modules_is_stored_once_its_class_is_registered(tmp_path, monkeypatch):
    file = tmp_path / "best.safetensors"
    proposals = tuple(_policy(deterministic=flag).actor for flag in (True, False))
    critics = CriticEnsemble(
        init_critics(jr.key(3), 3, 2, (4,), 2, "layer", 1.0), init_priors(jr.key(3), 3, 2, (4,), 2, 0.5)
    )
    policy = dataclasses.replace(_policy(), actor=Best(proposals, critics, 0.25))
    with pytest.raises(ConfigError, match=r"actor: a Best cannot be stored; register its class as .*KINDS"):
        policy.save(file)
    assert not list(tmp_path.iterdir()), "nothing half-written is left"
    monkeypatch.setitem(stored.KINDS, "best", Best)
    policy.save(file)
    found, rows = Policy.load(file), np.ones((4, 3), np.float32)
    assert isinstance(found.actor, Best) and found.actor.margin == 0.25
    np.testing.assert_array_equal(found(rows), policy(rows))
    monkeypatch.delitem(stored.KINDS, "best")
    with pytest.raises(CheckpointError, match=r"best.safetensors: actor: .*'best' is not known.*import that first"):
        Policy.load(file)


# ---- writing -------------------------------------------------------------------------------------------------------


def test_a_write_that_breaks_off_leaves_the_old_file(tmp_path, monkeypatch):
    file = tmp_path / "policy.safetensors"
    _policy(seed=1).save(file)
    before = file.read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CheckpointError, match=r"policy.safetensors: cannot be written \(No space left"):
        _policy(seed=2).save(file)
    assert file.read_bytes() == before and [child.name for child in tmp_path.iterdir()] == [file.name]
    with pytest.raises(CheckpointError, match="cannot be written"):
        _policy().save(tmp_path / "missing" / "policy.safetensors")


# ---- files that are refused ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> bytes:
    file = tmp_path_factory.mktemp("good") / "policy.safetensors"
    _policy().save(file)
    return file.read_bytes()


FIRST, SECOND = "actor/network/weights/0", "actor/network/weights/1"


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda h: h[FIRST].update(dtype="F33"), "dtype 'F33' is not known"),
        (lambda h: h[FIRST].update(dtype="F64"), "takes 120 bytes, its data_offsets give 60"),
        (lambda h: h[FIRST].update(dtype=["F32"]), "is not known"),
        (lambda h: h[FIRST].update(shape=[3, 6]), "takes 72 bytes"),
        (lambda h: h[FIRST].update(shape=[-3, -5]), "not a short list of counts"),
        (lambda h: h[FIRST].update(shape=[True] * 15), "not a short list of counts"),
        (lambda h: h[FIRST].update(shape=[15.0]), "not a short list of counts"),
        (lambda h: h[FIRST].update(shape=[2**62, 2**62, 0], data_offsets=[0, 0]), "hole or an overlap|too large"),
        (lambda h: h[FIRST].update(data_offsets=[4, 64]), "hole or an overlap"),
        (lambda h: h[SECOND].update(data_offsets=[0, 80]), "hole or an overlap"),
        (lambda h: h[FIRST].update(data_offsets=[60, 0]), "give -60"),
        (lambda h: h[FIRST].update(data_offsets=[0, 30, 60]), "not two counts"),
        (lambda h: h[FIRST].update(data_offsets=[0, 2**70]), "not two counts"),
        (lambda h: h[FIRST].update(more=1), "must hold dtype, shape and data_offsets"),
        (lambda h: h.update({FIRST: 1}), "must hold dtype, shape and data_offsets"),
        (lambda h: h.pop(FIRST), "hole or an overlap"),
        (
            lambda h: h.update(extra={"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}),
            "belong to nothing: 'extra'",
        ),
        (lambda h: h.update(__metadata__={"format": 1}), "must hold texts alone"),
        (lambda h: h.update(__metadata__=[]), "must hold texts alone"),
        (lambda h: h.pop("__metadata__"), "format: expected 'odaf-policy', found None"),
        (lambda h: h["__metadata__"].update(version="2"), "version: expected '1', found '2'"),
        (lambda h: h["__metadata__"].update(policy="[]"), "expected a JSON object"),
        (lambda h: h["__metadata__"].update(policy="[" * 100_000), "cannot be read as JSON"),
        (lambda h: h["__metadata__"].update(policy='{"a": NaN}'), "NaN is no number"),
        (lambda h: h["__metadata__"].update(policy='{"a": 1, "a": 2}'), "a key stands twice"),
        (lambda h: h["__metadata__"].update(policy="{}"), "expected actor, observations"),
        (lambda h: h["__metadata__"].update(sha256="0" * 64), "sha256: the content was changed"),
    ],
)
def test_a_header_that_breaks_a_rule_is_refused_by_name(tmp_path, good, change, named):
    file = tmp_path / "policy.safetensors"
    file.write_bytes(good)
    header, data = _header(file)
    change(header)
    _write(file, header, data)
    with pytest.raises(CheckpointError, match=rf"policy\.safetensors: .*({named})"):
        Policy.load(file)


def _set(content: dict, path: str, value) -> None:
    *above, last = path.split(".")
    for name in above:
        content = content[int(name) if isinstance(content, list) else name]
    content[int(last) if isinstance(content, list) else last] = value


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        ("actor.kind", "os.system", r"kind 'os.system' is not known; known are critics, .*deterministic, .*mlp, "),
        ("actor.kind", ["mlp"], "is not known"),
        ("actor.network", None, "actor: "),
        ("actor", {"array": [3, 5]}, "actor: "),
        ("actor", 7, "expected a module, an array or a list"),
        ("actor.network.activation", "exec", "actor/network/activation: expected .*relu.*found 'exec'"),
        ("actor.network.products", 1, "actor/network/products: "),
        ("actor.network.more", 1, "has the fields weights"),
        ("actor.network.weights", [], "belong to nothing"),
        ("actor.network.weights.0", {"array": [5, 3]}, r"expected an array of shape \[5, 3\], found \[3, 5\]"),
        ("actor.network.biases.0", None, "actor: "),
        ("actor.network.weights.2", {"array": [1]}, "its array is missing"),
        ("observations.names", ["a", "b"], "observations: names: has 2 entries for 3 columns"),
        ("observations.names", ["a", "b", "a"], "a name stands twice"),
        ("observations.names", ["a", "b", 1], "something of another type"),
        ("observations.units", "m", "every entry must be a list"),
        ("observations", {}, "observations: expected names, units"),
        ("actions.low", [-1.0], "entries for 1 columns"),
        ("actions.low", [-1.0, 9.0], "no finite bounds in ascending order"),
        ("actions.high", [1.0, 10**400], "no finite bounds"),
        ("actions.high", [1.0, True], "something of another type"),
        ("normaliser.mean", [0.0, 0.0], "normaliser: "),
        ("normaliser.std", [1.0, 1.0, -1.0], "normaliser: "),
        ("normaliser.epsilon", 10**400, "normaliser: "),
        ("normaliser", [], "normaliser: "),
        ("provenance", [], "provenance: must be a JSON object"),
    ],
)
def test_a_policy_that_contradicts_itself_is_refused_by_name(tmp_path, good, path, value, named):
    file = tmp_path / "policy.safetensors"
    file.write_bytes(good)
    header, data = _header(file)
    content = json.loads(header["__metadata__"]["policy"])
    if path == "actor.network.weights.2":
        content["actor"]["network"]["weights"].append(None)
    _set(content, path, value)
    text = json.dumps(content)
    header["__metadata__"] |= {"policy": text, "sha256": hashlib.sha256(text.encode() + data).hexdigest()}
    _write(file, header, data)
    with pytest.raises(CheckpointError, match=rf"policy\.safetensors: .*{named}"):
        Policy.load(file)


def test_parameters_of_a_type_that_would_be_rounded_are_refused(tmp_path):
    file = tmp_path / "policy.safetensors"
    with jax.enable_x64(True):
        policy = dataclasses.replace(_policy(), actor=tiny.in_double(_policy().actor))
        assert jax.tree.leaves(policy.actor)[0].dtype == jnp.float64
        policy.save(file)
    with pytest.raises(CheckpointError, match="would not keep the type float64"):
        Policy.load(file)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x08",
        (2**63).to_bytes(8, "little"),
        (100).to_bytes(8, "little") + b"{}",
        (2).to_bytes(8, "little") + b"[]",
        (2).to_bytes(8, "little") + b"\xff\xff",
        (2).to_bytes(8, "little") + b"{}more",
        (8).to_bytes(8, "little") + b'{"a":1,}',
        (200_000).to_bytes(8, "little") + b"[" * 200_000,
        (5008).to_bytes(8, "little") + b'{"a": ' + b"9" * 5001 + b"}",
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path, content):
    file = tmp_path / "policy.safetensors"
    file.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"policy\.safetensors: .*Write it again with"):
        Policy.load(file)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    for path in (tmp_path / "none.safetensors", tmp_path):
        with pytest.raises(CheckpointError, match=f"{path.name}: cannot be read"):
            Policy.load(path)


@settings(max_examples=100)
@given(data=st.data())
def test_no_cut_and_no_changed_byte_changes_a_policy_unnoticed(tmp_path_factory, good, data):
    file = tmp_path_factory.mktemp("damaged") / "policy.safetensors"
    if data.draw(st.booleans()):
        file.write_bytes(good[: data.draw(st.integers(0, len(good) - 1))])
    else:
        position, mask = data.draw(st.integers(0, len(good) - 1)), data.draw(st.integers(1, 255))
        file.write_bytes(good[:position] + bytes([good[position] ^ mask]) + good[position + 1 :])
    try:
        found = Policy.load(file)
    except CheckpointError as error:
        assert "policy.safetensors: " in str(error)
        return
    # White space between the parts and the version that wrote the file are remarks that nothing depends on.
    found.save(file)
    assert file.read_bytes() == good
