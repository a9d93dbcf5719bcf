"""Networks and critics as operations of a program."""

import numpy as np

from odaf.components.networks import LAYER_NORM_EPSILON, MLP
from odaf.deployment.program import Builder, Value
from odaf.errors import ConfigError


def mlp(builder: Builder, network: MLP, path: str, *parts: Value, outputs: int | None = None) -> Value:
    """What the network, or each network of a stack, gives for inputs that stand side by side in these parts.

    Every part meets its own rows of the first weights, so what all draws share is computed once.

    Args:
        builder: of the program.
        network: single or stacked.
        path: its constants are named by it.
        parts: values whose widths add up to the network's input.
        outputs: only so many first columns of the last layer; None for all.

    Raises:
        ConfigError: its products are rounded, which no form does.
    """
    if network.products != "float32":
        raise ConfigError(
            f"{path}: rounds its products to {network.products}, which no form of the artefact does; train with "
            "products='float32'"
        )
    last, x, first = len(network.weights) - 1, None, 0
    for layer, (weights, biases) in enumerate(zip(network.weights, network.biases, strict=True)):
        weight, bias = _stacked(weights, 3), _stacked(biases, 2)[:, None]
        if layer == last and outputs is not None:
            weight, bias = weight[..., :outputs], bias[..., :outputs]
        offset = builder.parameter(f"{path}/biases/{layer}", bias)
        if x is None:
            for place, part in enumerate(parts):
                own = weight[:, first : first + part.width]
                name = f"{path}/weights/0" + (f"/{place}" if len(parts) > 1 else "")
                product = builder("affine", part, builder.parameter(name, own), *([] if place else [offset]))
                x = product if x is None else builder("add", x, product)
                first += part.width
        else:
            x = builder("affine", x, builder.parameter(f"{path}/weights/{layer}", weight), offset)
        if layer < last and x is not None:
            if network.scales:
                scale, shift = (_stacked(each[layer], 2)[:, None] for each in (network.scales, network.offsets))
                x = builder("standardise", x, epsilon=LAYER_NORM_EPSILON)
                x = builder("multiply", x, builder.parameter(f"{path}/scales/{layer}", scale))
                x = builder("add", x, builder.parameter(f"{path}/offsets/{layer}", shift))
            x = builder(network.activation, x)
    assert x is not None
    return x


def _stacked(array: object, axes: int) -> np.ndarray:
    """With a first axis of members, of which a single network has one."""
    numbers = np.asarray(array)
    return numbers if numbers.ndim == axes else numbers[None]
