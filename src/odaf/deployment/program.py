"""What a deployed policy computes, as a straight line of a few named operations: one description for three forms.

A program takes inputs and carries (what it remembers from the step before), and gives outputs and the next carries.
Every value is an array of float32 with three axes, [stack, draws, width]: members of an ensemble, candidates of one
step, and columns. Axes of size one are stretched, as NumPy does.

    affine(x, weight[, bias])      x @ weight + bias; weight [stack, in, out], bias [stack, 1, out]
    add subtract multiply divide minimum maximum less (a, b)         less gives 1 or 0
    relu silu tanh exp sqrt absolute (x)
    finite(x)                      1 where a number is finite, else 0
    standardise(x; epsilon)        to mean 0 and variance 1 along the columns; what layer normalisation begins with
    concatenate(a, b, ...)         columns side by side; of equal stack and draws
    slice(x; first, last)          some columns
    sum mean smallest largest (x; axis)
    best(values, candidates)       the candidate whose value is largest; of equal ones the first
    select(condition, a, b)        a where the condition is not 0, else b; whatever stands in the other one

NaN may be lost in minimum, maximum, relu, less, smallest and largest: the three forms differ there. What must refuse it
asks `finite` first and ends with `select`, as `odaf.deployment.policies` does.

Writers of forms take a program and know nothing of policies: `safetensors_form` (run by `odaf_policy.py`), `onnx_form`,
`c_form`. Another operation is an entry in `OPERATIONS` here, in `odaf_policy.OPERATIONS`, in `onnx_form.NODES` and in
`c_form.LOOPS`, and a line in the test that compares all forms on all operations. To add more to a policy's program,
such as a guard, take the `Builder` and the values that `odaf.deployment.policies.describe` returns, apply operations,
and name further outputs and carries before `Builder.program` is called; networks are written by
`odaf.deployment.networks`. All forms offer every output by its name.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.errors import ConfigError

Shape = tuple[int, int, int]
STACK, DRAWS, WIDTH = 0, 1, 2
STATUS = "status"  # the output that says whether the others may be used: 0, or why not


@dataclass(frozen=True)
class Value:
    """A named array inside a program: an input, a constant, or what an operation gave."""

    name: str
    shape: Shape
    constant: bool = False  # the same at every step

    @property
    def width(self) -> int:
        """Columns."""
        return self.shape[WIDTH]


@dataclass(frozen=True)
class Operation:
    """One line of a program: `result` = `kind` of the named arguments, with plain attributes."""

    kind: str
    result: str
    arguments: tuple[str, ...]
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class Port:
    """An input or output: its name, that of its value, and what its columns are called and measured in."""

    name: str
    value: Value
    columns: tuple[str, ...]
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class Carry:
    """What is remembered: the value before the first step, and what becomes of it after each.

    Attributes:
        value: as the step sees it.
        next: after the step.
        start: before the first step; NaN where nothing is known.
        of: the output whose columns stand first in it, if it remembers what was put out: who plays something else can
            tell so. Empty otherwise.
    """

    value: Value
    next: Value
    start: tuple[float, ...]
    of: str = ""


@dataclass(frozen=True)
class Program:
    """See the module. Operations stand in the order in which they are computed."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    carries: tuple[Carry, ...]
    operations: tuple[Operation, ...]
    constants: Mapping[str, np.ndarray]
    shapes: Mapping[str, Shape]

    def to_dict(self) -> dict[str, Any]:
        """Everything but the constants, in JSON types; NaN is None."""
        return {
            "inputs": [_port(port) for port in self.inputs],
            "outputs": [_port(port) for port in self.outputs],
            "carries": [
                {
                    "name": carry.value.name,
                    "next": carry.next.name,
                    "start": [None if math.isnan(value) else value for value in carry.start],
                    "of": carry.of,
                }
                for carry in self.carries
            ],
            "operations": [[o.kind, o.result, list(o.arguments), dict(o.attributes)] for o in self.operations],
        }


class Builder:
    """Collects the operations of one program; `builder("tanh", x)` appends one and returns its value."""

    def __init__(self) -> None:
        self._values: dict[str, Value] = {}
        self._constants: dict[str, np.ndarray] = {}
        self._operations: list[Operation] = []
        self._inputs: list[Port] = []
        self._outputs: list[Port] = []
        self._carries: list[Carry] = []
        self._starts: dict[str, tuple[float, ...]] = {}

    def input(self, name: str, columns: Sequence[str], units: Sequence[str] = ()) -> Value:
        """One observation of a step, a number a column."""
        value = self._named(Value(name, (1, 1, len(columns))))
        self._inputs.append(Port(name, value, tuple(columns), tuple(units)))
        return value

    def remembered(self, name: str, start: Sequence[float]) -> Value:
        """What `remember` told of the step before; `start` at the first."""
        self._starts[name] = tuple(start)
        return self._named(Value(name, (1, 1, len(start))))

    def remember(self, before: Value, after: Value, of: str = "") -> None:
        """The next step sees `after` where this one saw `before`; `of` as in `Carry`."""
        self._carries.append(Carry(before, after, self._starts[before.name], of))

    def taken_back(self) -> list[tuple[Value, Value]]:
        """(before, after) of whatever was handed to `remember` so far, which is then as if it had not been."""
        found = [(carry.value, carry.next) for carry in self._carries]
        self._carries.clear()
        return found

    def output(self, name: str, value: Value, columns: Sequence[str] = (), units: Sequence[str] = ()) -> None:
        """Gives a value of one row to whoever runs the program."""
        if value.shape[:WIDTH] != (1, 1) or value.constant:
            raise ValueError(f"{name}: shape {value.shape} is no row that comes of the inputs")
        self._outputs.append(Port(name, value, tuple(columns) or (name,), tuple(units)))

    def constant(self, name: str, array: Any) -> Value:
        """Numbers of one, two or three axes; those that are missing are the first."""
        numbers = np.asarray(array, np.float32)
        numbers = np.ascontiguousarray(numbers.reshape((1,) * (3 - numbers.ndim) + numbers.shape))
        stack, draws, width = numbers.shape
        if name in self._constants and np.array_equal(self._constants[name], numbers, equal_nan=True):
            return self._values[name]  # a network that is asked twice
        self._constants[name] = numbers
        return self._named(Value(name, (stack, draws, width), constant=True))

    def parameter(self, name: str, array: Any) -> Value:
        """A constant that training found.

        Raises:
            ConfigError: it is not finite.
        """
        if not np.isfinite(np.asarray(array)).all():
            raise ConfigError(
                f"{name}: holds numbers that are not finite, because training diverged; take an earlier checkpoint "
                "with step="
            )
        return self.constant(name, array)

    def __call__(self, kind: str, *arguments: Value, **attributes: Any) -> Value:
        """The value of one more operation."""
        shape = OPERATIONS[kind](*(argument.shape for argument in arguments), **attributes)
        constant = all(argument.constant for argument in arguments)
        if kind == "concatenate" and any(argument.constant for argument in arguments):
            raise ValueError("concatenate: a constant has no rows to stand beside; add it after an affine operation")
        result = self._named(Value(f"t{len(self._operations)}", shape, constant))
        names = tuple(argument.name for argument in arguments)
        self._operations.append(Operation(kind, result.name, names, attributes))
        return result

    def program(self) -> Program:
        """What was described; what no output and no carry needs is left out."""
        needed = {port.value.name for port in self._outputs} | {carry.next.name for carry in self._carries}
        kept: list[Operation] = []
        for operation in reversed(self._operations):
            if operation.result in needed:
                needed |= set(operation.arguments)
                kept.append(operation)
        return Program(
            tuple(self._inputs),
            tuple(self._outputs),
            tuple(self._carries),
            tuple(reversed(kept)),
            {name: array for name, array in self._constants.items() if name in needed},
            {name: value.shape for name, value in self._values.items() if name in needed},
        )

    def _named(self, value: Value) -> Value:
        if value.name in self._values:
            raise ValueError(f"{value.name}: is in the program already")
        self._values[value.name] = value
        return value


def _port(port: Port) -> dict[str, Any]:
    return {"name": port.name, "value": port.value.name, "columns": list(port.columns), "units": list(port.units)}


def _same(shape: Shape, **attributes: Any) -> Shape:
    del attributes
    return shape


def _stretched(*shapes: Shape) -> Shape:
    sizes = [set(axis) - {1} for axis in zip(*shapes, strict=True)]
    if any(len(axis) > 1 for axis in sizes):
        raise ValueError(f"shapes {shapes} do not fit together")
    stack, draws, width = (max(axis, default=1) for axis in sizes)
    return stack, draws, width


def _affine(x: Shape, weight: Shape, bias: Shape | None = None) -> Shape:
    if x[WIDTH] != weight[1] or (bias is not None and bias[DRAWS] > 1):
        raise ValueError(f"affine: {x[WIDTH]} columns, weights {weight} and bias {bias} do not fit together")
    product = (_stretched((x[0], 1, 1), (weight[0], 1, 1))[0], x[DRAWS], weight[2])
    return product if bias is None else _stretched(product, bias)


def _concatenated(*shapes: Shape) -> Shape:
    if len({shape[:2] for shape in shapes}) > 1:
        raise ValueError(f"concatenate: shapes {shapes} differ in more than their columns")
    return (*shapes[0][:2], sum(shape[WIDTH] for shape in shapes))


def _sliced(shape: Shape, first: int, last: int) -> Shape:
    if not 0 <= first < last <= shape[WIDTH]:
        raise ValueError(f"slice: columns {first} to {last} are not all among {shape[WIDTH]}")
    return (*shape[:2], last - first)


def _reduced(shape: Shape, axis: int) -> Shape:
    stack, draws, width = (1 if index == axis else size for index, size in enumerate(shape))
    return stack, draws, width


def _best(values: Shape, candidates: Shape) -> Shape:
    if values != (1, candidates[DRAWS], 1) or candidates[0] != 1:
        raise ValueError(f"best: values {values} do not fit candidates {candidates}")
    return 1, 1, candidates[WIDTH]


OPERATIONS: dict[str, Callable[..., Shape]] = {
    "affine": _affine,
    **dict.fromkeys(("add", "subtract", "multiply", "divide", "minimum", "maximum", "less"), _stretched),
    **dict.fromkeys(("relu", "silu", "tanh", "exp", "sqrt", "absolute", "finite", "standardise"), _same),
    "concatenate": _concatenated,
    "slice": _sliced,
    **dict.fromkeys(("sum", "mean", "smallest", "largest"), _reduced),
    "best": _best,
    "select": _stretched,
}
"""The shape that each kind of operation gives, from those of its arguments and its attributes."""
