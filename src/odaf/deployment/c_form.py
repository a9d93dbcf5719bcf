"""A program as one header of C99 with the weights in it, and a test that is shipped beside it.

The header needs <math.h> and <string.h>, allocates nothing, and runs one step at a time. Whether a number is finite is
read from its bits, so that NaN is refused even where the compiler was told that there is none (-ffast-math). Every
sum runs from the first term to the last, over outputs that stand side by side: compilers make vectors of them without
leave to change the order.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from odaf.deployment.c_text import ACTED, HELPERS, ONE, TEST
from odaf.deployment.program import DRAWS, STACK, STATUS, WIDTH, Carry, Operation, Port, Program, Shape

_A_LINE = 8  # numbers


def write_c(program: Program, path: Path, about: Sequence[str]) -> None:
    """Writes the header.

    Args:
        program: of one input; its output `status` is what `policy_act` returns.
        path: the file.
        about: lines for its head: where the policy comes from, and what it takes and gives.
    """
    path.write_text(_Header(program).text(about), encoding="ascii")


class _Header:
    def __init__(self, program: Program):
        self.program = program
        self.places: dict[str, str] = {}  # what each value is called in C
        self.rooms: dict[str, int] = {}  # where in the state's scratch each result begins
        for index, name in enumerate(program.constants):
            self.places[name] = f"policy_c{index}"
        for port in program.inputs:
            self.places[port.value.name] = port.name
        for carry in program.carries:
            self.places[carry.value.name] = f"s->{carry.value.name}"
        self.scratch = self._scratch()

    def text(self, about: Sequence[str]) -> str:
        program = self.program
        given = [port for port in program.outputs if port.name != STATUS]
        arguments = ", ".join(
            ["policy_state *s", *(f"const float *{port.name}" for port in program.inputs)]
            + [f"float *{port.name}" for port in given]
        )
        parts = [
            _comment([*about, *_USE, *(_USE_GUARD if any(port.name == "guard" for port in given) else ())]),
            "#ifndef ODAF_POLICY_H\n#define ODAF_POLICY_H",
            "#include <math.h>\n#include <stdint.h>\n#include <string.h>",
            "#ifdef __cplusplus\n#define POLICY_RESTRICT\n#else\n#define POLICY_RESTRICT restrict\n#endif",
            *(_columns(port) for port in (*program.inputs, *given)),
            HELPERS,
            *(self._constant(name, array) for name, array in program.constants.items()),
            self._state(),
            self._begin(),
            f"static inline int policy_step({arguments})\n{{\n{self._body(given)}}}",
            self._one(given),
            *(self._acted(carry) for carry in program.carries if carry.of),
            "#endif",
        ]
        return "\n\n".join(parts) + "\n"

    def _scratch(self) -> int:
        """Gives every result a place in one array, in which places are used again; returns how long it must be."""
        last = {name: index for index, each in enumerate(self.program.operations) for name in each.arguments}
        for kept in (*(port.value.name for port in self.program.outputs), *(c.next.name for c in self.program.carries)):
            last[kept] = len(self.program.operations)
        taken: dict[str, tuple[int, int]] = {}
        length = 0
        for index, operation in enumerate(self.program.operations):
            size, place = math.prod(self.program.shapes[operation.result]), 0
            for begin, end in sorted(taken.values()):
                if place + size <= begin:
                    break
                place = max(place, end)
            taken[operation.result] = (place, place + size)
            length = max(length, place + size)
            self.places[operation.result] = operation.result
            self.rooms[operation.result] = place
            taken = {name: extent for name, extent in taken.items() if last.get(name, -1) > index}
        return length

    def _constant(self, name: str, array: np.ndarray) -> str:
        numbers = [_number(value) for value in array.reshape(-1).tolist()]
        lines = [", ".join(numbers[first : first + _A_LINE]) for first in range(0, len(numbers), _A_LINE)]
        head = (
            f"/* {_harmless(name)} {list(array.shape)} */\nstatic const float {self.places[name]}[{array.size}] = {{\n"
        )
        return head + ",\n".join(f"    {line}" for line in lines) + "\n};"

    def _state(self) -> str:
        fields = [f"    float {carry.value.name}[{carry.value.width}];" for carry in self.program.carries]
        comment = "/* What is remembered from step to step, and room for what a step computes. */"
        scratch = f"    float scratch[{max(self.scratch, 1)}];"
        return "\n".join([f"{comment}\ntypedef struct {{", *fields, scratch, "} policy_state;"])

    def _begin(self) -> str:
        lines = [
            f"    s->{carry.value.name}[{index}] = {'policy_unknown()' if math.isnan(start) else _number(start)};"
            for carry in self.program.carries
            for index, start in enumerate(carry.start)
        ]
        return "\n".join(["static inline void policy_begin_state(policy_state *s)\n{", *lines, "    (void)s;\n}"])

    def _one(self, given: Sequence[Port]) -> str:
        """`policy_act` for one plant; outputs beside the first are left in arrays of their own."""
        more = given[1:]
        kept = "".join(f"static float policy_{port.name}[{port.value.width}];\n" for port in more)
        return kept + ONE.replace(
            "obs, act)", ", ".join(["obs", "act", *(f"policy_{port.name}" for port in more)]) + ")"
        )

    def _acted(self, carry: Carry) -> str:
        width = next(port.value.width for port in self.program.outputs if port.name == carry.of)
        return ACTED.format(carry=carry.value.name, of=carry.of, width=width)

    def _body(self, given: Sequence[Port]) -> str:
        shapes, lines = self.program.shapes, []
        for operation in self.program.operations:
            result, arguments = self.places[operation.result], [self.places[name] for name in operation.arguments]
            sizes = [shapes[operation.result], *(shapes[name] for name in operation.arguments)]
            lines.append(
                f"    float *const {result} = s->scratch + {self.rooms[operation.result]}; /* {operation.kind} */"
            )
            lines.append(LOOPS[operation.kind](operation, result, arguments, sizes))
        copies = [(port.name, port.value.name, port.value.width) for port in given]
        copies += [(f"s->{each.value.name}", each.next.name, each.value.width) for each in self.program.carries]
        lines += [f"    memcpy({to}, {self.places[name]}, {width} * sizeof(float));" for to, name, width in copies]
        status = [self.places[port.value.name] for port in self.program.outputs if port.name == STATUS]
        return "\n".join([*lines, f"    return (int){status[0]}[0];" if status else "    return 0;"]) + "\n"


Loop = Callable[[Operation, str, list[str], list[Shape]], str]
_AXES = ("m", "d", "k")  # members, draws, columns


def _elementwise(expression: str) -> Loop:
    """`expression` of {a}, {b}, {c}: the arguments' entries, stretched where an axis is one."""

    def write(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
        del operation
        if all(size == sizes[0] for size in sizes):
            sizes = [(1, 1, math.prod(sizes[0]))] * len(sizes)
        entries = {
            letter: f"{name}[{_index(size)}]" for letter, name, size in zip("abc", arguments, sizes[1:], strict=False)
        }
        return _loops(sizes[0], f"{result}[{_index(sizes[0])}] = {expression.format(**entries)};")

    return write


def _affine(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
    out, x, weight, *_ = sizes
    bias = f"{arguments[2]} + {_row(sizes[3])}" if len(arguments) > 2 else "NULL"
    call = f"policy_affine({x[WIDTH]}, {out[WIDTH]}, {arguments[0]} + {_row(x)}, "
    member = "0" if weight[STACK] == 1 else f"m * {weight[1] * weight[2]}"
    call += f"{arguments[1]} + {member}, {bias}, {result} + {_row(out)});"
    return _loops((out[STACK], out[DRAWS], 1), call)


def _standardise(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
    epsilon = _number(float(np.float32(operation.attributes["epsilon"])))
    call = f"policy_standardise({sizes[0][WIDTH]}, {epsilon}, {arguments[0]} + {_row(sizes[1])}, "
    return _loops((*sizes[0][:2], 1), f"{call}{result} + {_row(sizes[0])});")


def _concatenate(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
    lines, first = [], 0
    for name, size in zip(arguments, sizes[1:], strict=True):
        copy = f"memcpy({result} + {_row(sizes[0])} + {first}, {name} + {_row(size)}, {size[WIDTH]} * sizeof(float));"
        lines.append(_loops((*size[:2], 1), copy))
        first += size[WIDTH]
    return "\n".join(lines)


def _slice(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
    source = f"{arguments[0]} + {_row(sizes[1])} + {operation.attributes['first']}"
    copy = f"memcpy({result} + {_row(sizes[0])}, {source}, {sizes[0][WIDTH]} * sizeof(float));"
    return _loops((*sizes[0][:2], 1), copy)


def _reduced(expression: str, divided: bool = False) -> Loop:
    def write(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
        axis = operation.attributes["axis"]
        count, entry = sizes[1][axis], _index(sizes[1]).replace(_AXES[axis], "i")
        first = "0.0f" if expression == "r + x" else f"{arguments[0]}[{entry.replace('i', '0')}]"
        lines = [
            f"float r = {first};",
            f"for (size_t i = 0; i < {count}; ++i) {{ const float x = {arguments[0]}[{entry}]; r = {expression}; }}",
            f"{result}[{_index(sizes[0])}] = r{f' / {count}.0f' if divided else ''};",
        ]
        return _loops(sizes[0], " ".join(lines))

    return write


def _best(operation: Operation, result: str, arguments: list[str], sizes: list[Shape]) -> str:
    values, candidates = arguments
    width = sizes[2][WIDTH]
    return (
        f"    {{\n        size_t best = 0;\n        for (size_t d = 1; d < {sizes[1][DRAWS]}; ++d)\n"
        f"            if ({values}[d] > {values}[best]) best = d;\n"
        f"        memcpy({result}, {candidates} + best * {width}, {width} * sizeof(float));\n    }}"
    )


def _loops(shape: Sequence[int], body: str) -> str:
    """The body once for every m, d and k of the shape; axes of one are not looped over."""
    lines, indent = [], "    "
    for name, size in zip(_AXES, shape, strict=True):
        if size > 1:
            lines.append(f"{indent}for (size_t {name} = 0; {name} < {size}; ++{name})")
            indent += "    "
    return "\n".join([*lines, f"{indent}{{ {body} }}"])


def _index(shape: Shape) -> str:
    """Where the entry of m, d and k stands, in an array of this shape."""
    terms = [
        f"{name} * {stride}" if stride > 1 else name
        for name, size, stride in zip(_AXES, shape, (shape[1] * shape[2], shape[2], 1), strict=True)
        if size > 1
    ]
    return " + ".join(terms) or "0"


def _row(shape: Shape) -> str:
    """Where the columns of m and d begin."""
    return _index(shape).removesuffix("k").removesuffix(" + ") or "0"


LOOPS: dict[str, Loop] = {
    "affine": _affine,
    "add": _elementwise("{a} + {b}"),
    "subtract": _elementwise("{a} - {b}"),
    "multiply": _elementwise("{a} * {b}"),
    "divide": _elementwise("{a} / {b}"),
    "minimum": _elementwise("{a} < {b} ? {a} : {b}"),
    "maximum": _elementwise("{a} > {b} ? {a} : {b}"),
    "less": _elementwise("{a} < {b} ? 1.0f : 0.0f"),
    "relu": _elementwise("{a} > 0.0f ? {a} : 0.0f"),
    "silu": _elementwise("{a} / (1.0f + expf(-{a}))"),
    "tanh": _elementwise("tanhf({a})"),
    "exp": _elementwise("expf({a})"),
    "sqrt": _elementwise("sqrtf({a})"),
    "absolute": _elementwise("fabsf({a})"),
    "finite": _elementwise("policy_finite({a}) ? 1.0f : 0.0f"),
    "standardise": _standardise,
    "concatenate": _concatenate,
    "slice": _slice,
    "sum": _reduced("r + x"),
    "mean": _reduced("r + x", divided=True),
    "smallest": _reduced("x < r ? x : r"),
    "largest": _reduced("x > r ? x : r"),
    "best": _best,
    "select": _elementwise("{a} != 0.0f ? {b} : {c}"),
}
"""How C computes each kind of operation."""

_USE = (
    "",
    "Include this file in one source file; compile with -lm. Nothing is allocated, no file is read.",
    "policy_act returns 0 and fills the action, or refuses and fills it with NaN:",
    "1 a reading is not finite, 2 the steps before are not known yet, 3 the numbers ran over.",
    "policy_begin starts an episode. One process with several plants: policy_step with a policy_state each.",
)
_USE_GUARD = (
    "With its guard, 4 is an alarm: the action is there, and is what the reaction gives. 5: an alarm has stopped it",
    "until policy_begin; the action is NaN. policy_guard holds each part of the score beside its limit, which is 1.",
)


def _columns(port: Port) -> str:
    """Number, names and units of an input's or output's columns, and the number of each by its name."""
    name, upper = port.name, port.name.upper()
    rows = [f"    {_text(column)}," for column in port.columns]
    units = [f"    {_text(unit)}," for unit in (*port.units, *[""] * len(port.columns))[: len(port.columns)]]
    lines = [f"#define POLICY_{upper}S {len(port.columns)}"]
    lines += [f"static const char *const policy_{name}_names[] = {{", *rows, "};"]
    lines += [f"static const char *const policy_{name}_units[] = {{", *units, "};"]
    if all(re.fullmatch(r"[A-Za-z]\w*", column, re.ASCII) for column in port.columns):
        pairs = (f"    POLICY_{upper}_{column} = {index}," for index, column in enumerate(port.columns))
        lines += ["enum {", *pairs, "};"]
    lines.append(
        f"/* The number of a column by its name, -1 where there is none of that name. */\n"
        f"static inline int policy_{name}_column(const char *name)\n{{\n"
        f"    for (int k = 0; k < {len(port.columns)}; ++k)\n"
        f"        if (strcmp(policy_{name}_names[k], name) == 0) return k;\n    return -1;\n}}"
    )
    return "\n".join(lines)


def _number(value: float) -> str:
    """A literal that is read as the same float32."""
    if math.isnan(value):
        return "NAN"
    text = f"{value:.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def _text(text: str) -> str:
    """A literal; other characters than plain ones as the bytes of UTF-8."""
    return '"' + "".join(_byte(byte) for byte in text.encode(errors="replace")) + '"'


def _byte(byte: int) -> str:
    return chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}"


def _harmless(text: str) -> str:
    """For a comment."""
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("\\", "/")


def _comment(lines: Sequence[str]) -> str:
    return "\n".join(["/*", *(f" * {_harmless(line)}".rstrip() for line in lines), " */"])


def write_c_test(path: Path, vectors: Mapping[str, np.ndarray], tolerance: Sequence[float]) -> None:
    """Writes a main that compares `policy.h`, beside it, with what the policy itself does.

    Args:
        path: the file.
        vectors: `begin` [vectors] whether an episode starts, `observation` [vectors, columns], `status` [vectors],
            `action` [vectors, act_dim], and `played` [vectors, act_dim], NaN where what was put out was played.
        tolerance: how far each action may be off, in its unit.
    """
    rows = []
    for place in range(len(vectors["status"])):
        fields = [str(int(vectors["begin"][place])), str(int(vectors["status"][place]))]
        fields.append(str(int(not np.isnan(vectors["played"][place]).any())))
        for name in ("observation", "action", "played"):
            numbers = np.nan_to_num(vectors[name][place], nan=0.0).tolist()
            fields.append("{" + ", ".join(map(_number, numbers)) + "}")
        rows.append("    {" + ", ".join(fields) + "},")
    acted = (
        "        if (vectors[n].told) policy_acted(vectors[n].played);\n"
        if not np.isnan(vectors["played"]).all()
        else ""
    )
    text = TEST.format(
        columns=vectors["observation"].shape[1],
        actions=vectors["action"].shape[1],
        vectors="\n".join(rows),
        tolerance=", ".join(map(_number, tolerance)),
        acted=acted,
    )
    path.write_text(text, encoding="ascii")
