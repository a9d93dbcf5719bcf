"""A program is the same in all forms: every operation, stretched axes, memory, several outputs."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from golden.deployed import OnnxPolicy
from odaf.deployment import c_form, odaf_policy, onnx_form, program
from odaf.deployment.program import DRAWS, STACK, WIDTH, Builder, Program
from odaf.deployment.safetensors_form import write_safetensors

_MAIN = """
#include <stdio.h>
#include "policy.h"
int main(void)
{
    float x[5], y[POLICY_ACTIONS];
    while (fread(x, sizeof x, 1, stdin) == 1) {
        const float status = (float)policy_act(x, y);
        fwrite(&status, sizeof status, 1, stdout);
        fwrite(y, sizeof y, 1, stdout);
        fwrite(policy_score, sizeof policy_score, 1, stdout);
    }
    return 0;
}
"""


def _every_operation() -> Program:
    """Every operation there is, on all axes, with a memory."""
    rng, build = np.random.default_rng(0), Builder()
    x = build.input("observation", [f"c{index}" for index in range(5)])
    before = build.remembered("before", [np.nan, 0.5])
    weight, bias = (build.constant(name, rng.normal(size=size)) for name, size in (("w", (3, 5, 4)), ("b", (3, 1, 4))))
    hidden = build("standardise", build("silu", build("affine", x, weight, bias)), epsilon=1e-5)
    draws = build("tanh", build("add", hidden, build.constant("noise", rng.normal(size=(1, 6, 4)))))  # [3, 6, 4]
    narrow = build("affine", draws, build.constant("w2", rng.normal(size=(4, 2))))
    values = build("sum", build("mean", narrow, axis=STACK), axis=WIDTH)
    best = build("best", values, build("slice", build("largest", draws, axis=STACK), first=1, last=3))
    worst = build("sum", build("smallest", narrow, axis=DRAWS), axis=STACK)
    size = build("absolute", build("sqrt", build("exp", build("slice", x, first=0, last=2))))
    columns = [
        build("maximum", build("minimum", best, worst), size),
        build("less", best, worst),
        build("divide", best, build("add", build("absolute", worst), build.constant("one", 1.0))),
        build("multiply", size, build("largest", build("mean", narrow, axis=DRAWS), axis=STACK)),
    ]
    readable = build("smallest", build("finite", x), axis=WIDTH)
    joined = build("relu", build("concatenate", *columns))
    after = build("select", build("finite", before), build("subtract", before, build.constant("step", 0.1)), best)
    build.remember(before, build("select", readable, after, before))
    action = build("concatenate", build("select", readable, joined, build.constant("nan", np.nan)), after)
    build.output("action", action, [f"a{index}" for index in range(action.width)])
    build.output("score", build("largest", build("mean", build("sum", narrow, axis=WIDTH), axis=DRAWS), axis=STACK))
    build.output("status", build("less", readable, build.constant("half", 0.5)))
    return build.program()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place, written = tmp_path_factory.mktemp("program"), _every_operation()
    write_safetensors(written, place / "policy.safetensors")
    onnx_form.write_onnx(written, place / "policy.onnx", {})
    c_form.write_c(written, place / "policy.h", ["A program of the tests */"])
    return place


def _rows() -> np.ndarray:
    rows = np.random.default_rng(1).normal(size=(40, 5)).astype(np.float32)
    rows[3, 2], rows[7, 0], rows[8, 4] = np.nan, np.inf, -np.inf
    return rows


def _by_numpy(folder: Path) -> np.ndarray:
    policy = odaf_policy.Policy(folder / "policy.safetensors")
    found = [policy.run({"observation": row}) for row in _rows()]
    return np.array([np.concatenate([each[name] for name in ("status", "action", "score")]) for each in found])


def test_every_operation_is_in_the_program():
    kinds = {operation.kind for operation in _every_operation().operations}
    tables = (program.OPERATIONS, odaf_policy.OPERATIONS, onnx_form.NODES, c_form.LOOPS)
    assert all(set(table) == kinds for table in tables)


def test_the_graph_computes_what_numpy_does(folder: Path):
    policy, found = OnnxPolicy(folder / "policy.onnx"), []
    for row in _rows():
        every = policy.run({"observation": row[None]})
        policy.carry = {"before": every["next_before"]}
        found.append(np.concatenate([every["status"], every["action"][0], every["score"][0]]))
    _assert_same(np.array(found), _by_numpy(folder))


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize(
    "flags", [["-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsanitize=address,undefined"], ["-Ofast"]]
)
def test_c_computes_what_numpy_does_even_where_the_compiler_believes_there_is_no_nan(flags, folder: Path, tmp_path):
    (tmp_path / "main.c").write_text(_MAIN)
    words = ["cc", "-std=c99", *flags, f"-I{folder}", "main.c", "-lm", "-o", "main"]
    subprocess.run(words, check=True, cwd=tmp_path)
    done = subprocess.run([tmp_path / "main"], input=_rows().tobytes(), capture_output=True, check=True)
    _assert_same(np.frombuffer(done.stdout, np.float32).reshape(len(_rows()), -1), _by_numpy(folder))


def _assert_same(found: np.ndarray, wanted: np.ndarray) -> None:
    rows = _rows()
    refused = ~np.isfinite(rows).all(axis=1)
    np.testing.assert_array_equal(wanted[:, 0], refused)
    np.testing.assert_allclose(found[:, :-1], wanted[:, :-1], rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(found[~refused, -1], wanted[~refused, -1], rtol=2e-5, atol=1e-6)
    assert np.isnan(found[refused, 1:9]).all() and np.isfinite(found[:, 9:-1]).all(), "what is remembered stays known"


def test_what_does_not_fit_is_no_program():
    build = Builder()
    x = build.input("observation", ["a", "b"])
    for kind, arguments, attributes in (
        ("affine", (x, build.constant("w", np.ones((3, 1)))), {}),
        ("add", (x, build.constant("three", np.ones(3))), {}),
        ("slice", (x,), {"first": 1, "last": 3}),
        ("concatenate", (x, build.constant("two", np.ones(2))), {}),
        ("best", (x, x), {}),
    ):
        with pytest.raises(ValueError):
            build(kind, *arguments, **attributes)
    with pytest.raises(ValueError, match="in the program already"):
        build.constant("w", 1.0)
    with pytest.raises(ValueError, match="no row"):
        build.output("action", build("add", x, build.constant("draws", np.ones((4, 2)))))


def test_what_nothing_needs_is_left_out():
    build = Builder()
    x = build.input("observation", ["a", "b"])
    build("multiply", x, build.constant("unused", 2.0))
    build.output("action", build("add", x, build.constant("used", 1.0)))
    assert list(build.program().constants) == ["used"]


def test_a_squashed_number_of_the_graph_is_never_above_one(tmp_path):
    """onnxruntime's own Tanh is, for a good part of the numbers between 8.2 and 9 (findings/)."""
    build = Builder()
    build.output("action", build("tanh", build.input("observation", ["x"])))
    build.output("status", build("less", build.input("other", ["y"]), build.constant("zero", 0.0)))
    onnx_form.write_onnx(build.program(), tmp_path / "policy.onnx", {})
    numbers = np.linspace(8, 9.5, 10_001, dtype=np.float32)[:, None]
    found = OnnxPolicy(tmp_path / "policy.onnx").run({"observation": numbers, "other": numbers})["action"]
    assert found.max() == 1.0
