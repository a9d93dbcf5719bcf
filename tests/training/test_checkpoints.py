"""What a checkpoint refuses to load, and what it says."""

import hashlib
import io
import json
import os

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from odaf.errors import CheckpointError
from odaf.training import checkpoints


def _state(width=3):
    return {"weights": jnp.arange(2.0 * width).reshape(2, width), "count": jnp.asarray(7), "name": "not an array"}


@pytest.fixture
def saved(tmp_path):
    return checkpoints.save(tmp_path / "checkpoints", 40, _state(), {"seed": 3, "summary": {}})


def _change_header(saved, **fields):
    path = saved.path / "header.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


def _replace_content(saved, content: bytes):
    # A forger who also mends the checksum.
    (saved.path / "state.eqx").write_bytes(content)
    _change_header(saved, bytes=len(content), sha256=hashlib.sha256(content).hexdigest())


def test_round_trip_restores_arrays_types_and_the_rest_of_the_tree(saved):
    like = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if isinstance(leaf, jax.Array) else leaf, _state())
    loaded = saved.load(like, identity={"seed": 3})
    assert loaded["name"] == "not an array"
    for name in ("weights", "count"):
        np.testing.assert_array_equal(loaded[name], _state()[name])
        assert loaded[name].dtype == _state()[name].dtype
    shapes = {**_state(), "weights": jax.ShapeDtypeStruct((2, 3), jnp.float32)}
    np.testing.assert_array_equal(saved.load(shapes)["weights"], _state()["weights"])
    assert checkpoints.listed(saved.path.parent) == [saved]


def test_saving_the_same_step_again_replaces_it(saved):
    later = checkpoints.save(saved.path.parent, 40, {**_state(), "count": jnp.asarray(8)}, {"seed": 3})
    assert later == saved and int(saved.load(_state())["count"]) == 8
    assert [path.name for path in saved.path.parent.iterdir()] == ["00000040"]


def test_unfinished_writes_are_no_checkpoints(saved):
    (saved.path.parent / ".writing-1-00000080").mkdir()
    (saved.path.parent / "notes").mkdir()
    assert checkpoints.listed(saved.path.parent) == [saved]
    assert checkpoints.listed(saved.path / "nowhere") == []


def test_every_single_flipped_bit_or_missing_byte_is_noticed(saved):
    path = saved.path / "state.eqx"
    content = path.read_bytes()
    for index in range(0, len(content), 37):
        path.write_bytes(content[:index] + bytes([content[index] ^ 1]) + content[index + 1 :])
        with pytest.raises(CheckpointError, match=r"state\.eqx: sha256: expected .* Remove this checkpoint"):
            saved.load(_state())
    for length in (0, 1, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(CheckpointError, match=r"state\.eqx: size in bytes"):
            saved.load(_state())


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"format": "other"}, r"header\.json: format: expected 'odaf-checkpoint', found 'other'"),
        ({"version": 2}, r"header\.json: version: expected 1, found 2\. .*another version"),
        ({"step": 41}, r"header\.json: step: expected 40, found 41"),
        ({"seed": 4}, r"header\.json: seed: expected 3, found 4\. .*another run"),
        ({"leaves": None}, r"header\.json: leaves: expected a list of 2 arrays"),
        ({"leaves": []}, r"leaves: this config makes 2 arrays, the checkpoint holds 0"),
    ],
)
def test_wrong_header_names_the_field(saved, fields, named):
    _change_header(saved, **fields)
    with pytest.raises(CheckpointError, match=named):
        saved.load(_state(), identity={"seed": 3})


def test_torn_header_and_missing_files_are_named(saved):
    header = saved.path / "header.json"
    text = header.read_text()
    for torn in (text[:50], "[]", "\x00"):
        header.write_text(torn)
        with pytest.raises(CheckpointError, match=r"header\.json: .*Remove this checkpoint"):
            saved.load(_state())
    header.write_text(text)
    (saved.path / "state.eqx").unlink()
    with pytest.raises(CheckpointError, match=r"state\.eqx: cannot be read"):
        saved.load(_state())
    header.unlink()
    with pytest.raises(CheckpointError, match=r"header\.json: there is no such file"):
        saved.load(_state())


def test_state_of_another_config_is_named_by_its_first_array(saved):
    with pytest.raises(CheckpointError, match=r"makes \['weights'\] float32\[2, 4\], the checkpoint holds .*\[2, 3\]"):
        saved.load(_state(width=4))
    with pytest.raises(CheckpointError, match=r"int32\[2, 3\]"):
        saved.load({**_state(), "weights": jnp.zeros((2, 3), jnp.int32)})
    with pytest.raises(CheckpointError, match="makes 1 arrays, the checkpoint holds 2"):
        saved.load({"count": jnp.asarray(0)})


def test_mended_checksum_does_not_help_wrong_content(saved):
    _replace_content(saved, b"no arrays at all, but with a proper checksum")
    with pytest.raises(CheckpointError, match=r"cannot be read as arrays"):
        saved.load(_state())


def test_loading_never_unpickles(saved, tmp_path):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "exploded"),))

    buffer = io.BytesIO()
    np.save(buffer, np.array(Bomb(), dtype=object), allow_pickle=True)
    _replace_content(saved, buffer.getvalue() * 2)
    with pytest.raises(CheckpointError, match="cannot be read as arrays"):
        saved.load(_state())
    assert not (tmp_path / "exploded").exists()


def test_random_keys_are_refused_in_a_state(tmp_path):
    with pytest.raises(TypeError, match="no random keys"):
        checkpoints.save(tmp_path, 0, {"key": jr.key(0)}, {})
