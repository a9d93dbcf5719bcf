"""A number that may be traced: settings enter compiled code as arrays, see `odaf.algorithms.numbers`."""

from jaxtyping import Array, Float

Number = float | Float[Array, ""]
