"""A program as an ONNX graph of common operators, for onnxruntime and other runtimes; rows may be any number.

Inputs are `observation` [rows, columns] (or one [rows, 1] a column, under its name) and each carry [rows, width];
outputs are those of the program [rows, width], `status` [rows] as int32, and `next_` of each carry. Rows never touch
one another: every sum runs along columns, draws or members of one row.

onnxruntime's float32 Tanh reaches 1.0000002, so it is cut. Its ReduceMin, ReduceMax and ArgMax see a NaN only where it
stands first, so a program asks IsNaN and IsInf before anything else.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from odaf.deployment.program import STATUS, Operation, Program
from odaf.errors import ConfigError

OPSET, IR_VERSION = 17, 8
PREFIX = "program/"  # of names inside the graph, so that no column has one


def write_onnx(program: Program, path: Path, about: Mapping[str, str], named_inputs: bool = False) -> None:
    """Writes and checks the file.

    Args:
        program: what to write.
        path: the file.
        about: further metadata.
        named_inputs: an input for each column, under its name.

    Raises:
        ConfigError: the package `onnx` is not installed, or a column has the name of an output.
    """
    onnx = imported("onnx")
    graph = _Graph(onnx, program)
    for port in program.inputs:
        graph.input(port.name, port.value.name, port.columns if named_inputs else (), len(port.columns))
    for carry in program.carries:
        graph.input(carry.value.name, carry.value.name, (), carry.value.width)
    for operation in program.operations:
        NODES[operation.kind](graph, operation)
    for port in program.outputs:
        graph.output(port.name, port.value.name, port.value.width, whole=port.name == STATUS)
    for carry in program.carries:
        graph.output(f"next_{carry.value.name}", carry.next.name, carry.value.width)
    content = program.to_dict()
    del content["operations"]
    metadata = {name: json.dumps(entry) for name, entry in content.items()} | dict(about)
    onnx.save_model(graph.model(metadata), str(path))


def imported(name: str) -> Any:
    """The package, which is an extra.

    Raises:
        ConfigError: it is not installed.
    """
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"policy.onnx: needs the package {name} ({error}); install it with `pip install 'odaf[export]'`, or leave "
            "this form out with forms=['numpy', 'c']"
        ) from None


class _Graph:
    """Nodes, initialisers and ends, as they come."""

    def __init__(self, onnx: Any, program: Program):
        self._onnx = onnx
        self._nodes: list[Any] = []
        self._ends: tuple[list[Any], list[Any]] = [], []
        self._initialisers: dict[str, Any] = {}
        self._count = 0
        self.shapes = program.shapes
        for name, array in program.constants.items():
            flat = array.reshape(array.shape[1:]) if array.shape[0] == 1 else array  # two axes: one product of all rows
            self._initialisers[PREFIX + name] = onnx.numpy_helper.from_array(flat, PREFIX + name)

    def node(self, kind: str, *arguments: str, result: str | None = None, **attributes: Any) -> str:
        """The name of what one more node gives."""
        self._count += 1
        name = f"{PREFIX}n{self._count}" if result is None else result
        self._nodes.append(self._onnx.helper.make_node(kind, list(arguments), [name], **attributes))
        return name

    def whole(self, *numbers: int) -> str:
        """A constant list of whole numbers."""
        name = f"{PREFIX}whole/{'_'.join(map(str, numbers))}"
        array = np.array(numbers, np.int64)
        self._initialisers.setdefault(name, self._onnx.numpy_helper.from_array(array, name))
        return name

    def number(self, number: float) -> str:
        """A constant number."""
        name = f"{PREFIX}number/{number!r}"
        self._initialisers.setdefault(name, self._onnx.numpy_helper.from_array(np.array(number, np.float32), name))
        return name

    def cast(self, name: str, to: str, result: str | None = None) -> str:
        """The value in another type."""
        return self.node("Cast", name, result=result, to=getattr(self._onnx.TensorProto, to))

    def input(self, name: str, value: str, columns: Sequence[str], width: int) -> None:
        """[rows, width] becomes a value with all axes."""
        for column in columns:
            self._end(0, column, ["rows", 1])
        if columns:
            name = self.node("Concat", *columns, axis=1) if len(columns) > 1 else columns[0]
        else:
            self._end(0, name, ["rows", width])
        self.node("Unsqueeze", name, self.whole(1, 2), result=PREFIX + value)

    def output(self, name: str, value: str, width: int, whole: bool = False) -> None:
        """A value becomes [rows, width], or [rows] whole numbers."""
        if whole:
            flat = self.node("Squeeze", PREFIX + value, self.whole(1, 2, 3))
            self.cast(flat, "INT32", result=name)
        else:
            self.node("Squeeze", PREFIX + value, self.whole(1, 2), result=name)
        self._end(1, name, ["rows"] if whole else ["rows", width], "INT32" if whole else "FLOAT")

    def model(self, metadata: Mapping[str, str]) -> Any:
        """The checked model."""
        helper = self._onnx.helper
        graph = helper.make_graph(self._nodes, "policy", *self._ends, list(self._initialisers.values()))
        opset = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, producer_name="odaf", opset_imports=opset, ir_version=IR_VERSION)
        helper.set_model_props(model, dict(metadata))
        self._onnx.checker.check_model(model, full_check=True)
        return model

    def _end(self, side: int, name: str, shape: Sequence[str | int], kind: str = "FLOAT") -> None:
        if any(end.name == name for ends in self._ends for end in ends):
            raise ConfigError(
                f"named_inputs: '{name}' would be the name of two ends of the graph; leave named_inputs out, or rename "
                "the column"
            )
        make = self._onnx.helper.make_tensor_value_info
        self._ends[side].append(make(name, getattr(self._onnx.TensorProto, kind), shape))


Node = Callable[[_Graph, Operation], None]


def _same(kind: str) -> Node:
    def write(graph: _Graph, operation: Operation) -> None:
        graph.node(kind, *_arguments(operation), result=_result(operation))

    return write


def _affine(graph: _Graph, operation: Operation) -> None:
    x, weight, *bias = _arguments(operation)
    product = graph.node("MatMul", x, weight, result=None if bias else _result(operation))
    if bias:
        graph.node("Add", product, bias[0], result=_result(operation))


def _less(graph: _Graph, operation: Operation) -> None:
    graph.cast(graph.node("Less", *_arguments(operation)), "FLOAT", _result(operation))


def _silu(graph: _Graph, operation: Operation) -> None:
    (x,) = _arguments(operation)
    graph.node("Mul", x, graph.node("Sigmoid", x), result=_result(operation))


def _tanh(graph: _Graph, operation: Operation) -> None:
    squashed = graph.node("Tanh", *_arguments(operation))
    graph.node("Clip", squashed, graph.number(-1.0), graph.number(1.0), result=_result(operation))


def _finite(graph: _Graph, operation: Operation) -> None:
    (x,) = _arguments(operation)
    wrong = graph.node("Or", graph.node("IsNaN", x), graph.node("IsInf", x))
    graph.cast(graph.node("Not", wrong), "FLOAT", _result(operation))


def _standardise(graph: _Graph, operation: Operation) -> None:
    (x,) = _arguments(operation)
    centred = graph.node("Sub", x, graph.node("ReduceMean", x, axes=[-1]))
    variance = graph.node("ReduceMean", graph.node("Mul", centred, centred), axes=[-1])
    above_zero = graph.node("Add", variance, graph.number(operation.attributes["epsilon"]))
    graph.node("Div", centred, graph.node("Sqrt", above_zero), result=_result(operation))


def _concatenate(graph: _Graph, operation: Operation) -> None:
    graph.node("Concat", *_arguments(operation), result=_result(operation), axis=-1)


def _slice(graph: _Graph, operation: Operation) -> None:
    (x,), ends = _arguments(operation), operation.attributes
    first, last, axis = graph.whole(ends["first"]), graph.whole(ends["last"]), graph.whole(-1)
    graph.node("Slice", x, first, last, axis, result=_result(operation))


def _reduced(kind: str) -> Node:
    def write(graph: _Graph, operation: Operation) -> None:
        (x,), axis = _arguments(operation), operation.attributes["axis"] - 3
        if kind == "ReduceSum":  # its axes have been an input from opset 13 on
            graph.node(kind, x, graph.whole(axis), result=_result(operation))
        else:
            graph.node(kind, x, result=_result(operation), axes=[axis])

    return write


def _best(graph: _Graph, operation: Operation) -> None:
    values, candidates = _arguments(operation)
    place = graph.node("ArgMax", values, axis=-2, keepdims=1)
    width = graph.shapes[operation.arguments[1]][2]
    everywhere = graph.node("Expand", place, graph.whole(1, 1, 1, width))
    graph.node("GatherElements", candidates, everywhere, result=_result(operation), axis=-2)


def _select(graph: _Graph, operation: Operation) -> None:
    condition, a, b = _arguments(operation)
    graph.node("Where", graph.cast(condition, "BOOL"), a, b, result=_result(operation))


def _arguments(operation: Operation) -> list[str]:
    return [PREFIX + name for name in operation.arguments]


def _result(operation: Operation) -> str:
    return PREFIX + operation.result


NODES: dict[str, Node] = {
    "affine": _affine,
    "add": _same("Add"),
    "subtract": _same("Sub"),
    "multiply": _same("Mul"),
    "divide": _same("Div"),
    "minimum": _same("Min"),
    "maximum": _same("Max"),
    "less": _less,
    "relu": _same("Relu"),
    "silu": _silu,
    "tanh": _tanh,
    "exp": _same("Exp"),
    "sqrt": _same("Sqrt"),
    "absolute": _same("Abs"),
    "finite": _finite,
    "standardise": _standardise,
    "concatenate": _concatenate,
    "slice": _slice,
    "sum": _reduced("ReduceSum"),
    "mean": _reduced("ReduceMean"),
    "smallest": _reduced("ReduceMin"),
    "largest": _reduced("ReduceMax"),
    "best": _best,
    "select": _select,
}
"""How the graph computes each kind of operation."""
