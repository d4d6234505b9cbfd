"""A classifier as an ONNX model, made of its layer records: nothing of it is traced or run."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_training.bundle import layers as records
from veilcam_training.bundle.classifier import check_weights, output_shape
from veilcam_training.bundle.layers import LayerRecord
from veilcam_training.bundle.network import averages, interpolation
from veilcam_training.errors import TrainingError

OPSET = 17
"""The first with LayerNormalization."""
IR_VERSION = 8
"""That goes with it: read by every ONNX Runtime since 1.12."""
INPUT, OUTPUT = "measurement", "logits"

Weights = Mapping[str, npt.NDArray[Any]]


def onnx_model(
    layers: Sequence[LayerRecord], weights: Weights, *, inputs: int, labels: Sequence[str]
) -> bytes:
    """The file of an ONNX model from (batch, inputs) float32 to logits (batch, labels).

    Its metadata hold the labels, one a line.

    Args:
        layers: records in order.
        weights: of them, as a bundle holds them.
        inputs: how many numbers the classifier takes.
        labels: in the order of the logits.

    Raises:
        BundleError: layers and weights that do not fit.
        TrainingError: the package onnx is not installed.
    """
    try:
        from onnx import TensorProto, helper, numpy_helper  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise TrainingError(
            "ONNX files need the extra 'export': run pip install -e '.[export]' in the checkout"
        ) from None
    check_weights(layers, weights)
    (outputs,) = output_shape(layers, inputs)
    graph = _Graph(weights)
    shape: records.Shape = (inputs,)
    last = INPUT
    for index, layer in enumerate(layers):
        last = graph.layer(layer, last, str(index), shape)
        shape = layer.output_shape(shape)
    graph.add("Identity", last, name=OUTPUT)

    def value(name: str, size: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])

    model = helper.make_model(
        helper.make_graph(
            [
                helper.make_node(kind, list(taken), [name], name=name, **attributes)
                for kind, taken, name, attributes in graph.nodes
            ],
            "veilcam classifier",
            [value(INPUT, inputs)],
            [value(OUTPUT, outputs)],
            [numpy_helper.from_array(array, name) for name, array in graph.constants.items()],
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="veilcam",
    )
    helper.set_model_props(model, {"labels": "\n".join(labels)})
    content: bytes = model.SerializeToString(deterministic=True)
    return content


@dataclass
class _Graph:
    """Nodes in order, and the constants that they take."""

    weights: Weights
    nodes: list[tuple[str, tuple[str, ...], str, dict[str, Any]]] = field(default_factory=list)
    constants: dict[str, npt.NDArray[Any]] = field(default_factory=dict)

    def add(self, kind: str, *taken: str, name: str, **attributes: Any) -> str:
        self.nodes.append((kind, taken, name, attributes))
        return name

    def constant(self, name: str, values: npt.ArrayLike, dtype: type = np.float32) -> str:
        self.constants[name] = np.ascontiguousarray(values, dtype)
        return name

    def own(self, name: str) -> str:
        return self.constant(name, self.weights[name])

    def layer(self, layer: LayerRecord, taken: str, name: str, shape: records.Shape) -> str:
        """Add one layer, for samples of ``shape``; returns what it gives."""
        return _LAYERS[layer.kind](self, layer, taken, name, shape)


def _linear(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    bias = (graph.own(f"{name}.bias"),) if layer.bias else ()
    return graph.add("Gemm", taken, graph.own(f"{name}.weight"), *bias, name=name, transB=1)


def _batch_norm(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    own = [
        graph.own(f"{name}.{each}") for each in ("weight", "bias", "running_mean", "running_var")
    ]
    return graph.add("BatchNormalization", taken, *own, name=name, epsilon=layer.epsilon)


def _layer_norm(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    scale = (
        (graph.own(f"{name}.weight"), graph.own(f"{name}.bias"))
        if layer.affine
        else (graph.constant(f"{name}.weight", np.ones(layer.shape)),)
    )
    return graph.add("LayerNormalization", taken, *scale, name=name, axis=1, epsilon=layer.epsilon)


def _affine(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    scaled = graph.add("Mul", taken, graph.constant(f"{name}.scale", layer.scale), name=f"{name}.x")
    return graph.add("Add", scaled, graph.constant(f"{name}.offset", layer.offset), name=name)


def _relu(graph: _Graph, _: Any, taken: str, name: str, __: records.Shape) -> str:
    return graph.add("Relu", taken, name=name)


def _gelu(graph: _Graph, _: Any, taken: str, name: str, __: records.Shape) -> str:
    root = graph.constant(f"{name}.root", 1 / math.sqrt(2))
    error = graph.add(
        "Erf", graph.add("Mul", taken, root, name=f"{name}.scaled"), name=f"{name}.erf"
    )
    sides = graph.add("Add", error, graph.constant(f"{name}.one", 1.0), name=f"{name}.sides")
    share = graph.add("Mul", sides, graph.constant(f"{name}.half", 0.5), name=f"{name}.share")
    return graph.add("Mul", taken, share, name=name)


def _dropout(_: _Graph, __: Any, taken: str, ___: str, ____: records.Shape) -> str:
    return taken


def _flatten(graph: _Graph, _: Any, taken: str, name: str, __: records.Shape) -> str:
    return graph.add("Flatten", taken, name=name, axis=1)


def _reshape(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    shape = graph.constant(f"{name}.shape", (-1, *layer.shape), np.int64)
    return graph.add("Reshape", taken, shape, name=name)


def _resize(graph: _Graph, layer: Any, taken: str, name: str, shape: records.Shape) -> str:
    down, across = interpolation(layer.rows, shape[1]), interpolation(layer.columns, shape[2])
    return _along_both(graph, (down, across), taken, name)


def _average_pool(graph: _Graph, layer: Any, taken: str, name: str, shape: records.Shape) -> str:
    return _along_both(
        graph, (averages(layer.rows, shape[1]), averages(layer.columns, shape[2])), taken, name
    )


def _along_both(
    graph: _Graph,
    matrices: tuple[npt.NDArray[Any], npt.NDArray[Any]],
    taken: str,
    name: str,
) -> str:
    """As the daemon computes it: rows and columns are each multiplied by a matrix."""
    down, across = matrices
    along = graph.add("MatMul", graph.constant(f"{name}.down", down), taken, name=f"{name}.rows")
    return graph.add("MatMul", along, graph.constant(f"{name}.across", across.T), name=name)


def _conv2d(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    bias = (graph.own(f"{name}.bias"),) if layer.bias else ()
    return graph.add(
        "Conv",
        taken,
        graph.own(f"{name}.weight"),
        *bias,
        name=name,
        group=layer.groups,
        kernel_shape=[layer.kernel] * 2,
        pads=[layer.padding] * 4,
        strides=[layer.stride] * 2,
    )


def _max_pool(graph: _Graph, layer: Any, taken: str, name: str, _: records.Shape) -> str:
    side = [layer.kernel] * 2
    return graph.add("MaxPool", taken, name=name, kernel_shape=side, strides=side)


def _residual(graph: _Graph, layer: Any, taken: str, name: str, shape: records.Shape) -> str:
    last = taken
    for index, inner in enumerate(layer.layers):
        last = graph.layer(inner, last, f"{name}.layers.{index}", shape)
        shape = inner.output_shape(shape)
    return graph.add("Add", taken, last, name=name)


_LAYERS: Mapping[str, Callable[[_Graph, Any, str, str, records.Shape], str]] = {
    "linear": _linear,
    "batch_norm": _batch_norm,
    "layer_norm": _layer_norm,
    "affine": _affine,
    "relu": _relu,
    "gelu": _gelu,
    "dropout": _dropout,
    "flatten": _flatten,
    "reshape": _reshape,
    "resize": _resize,
    "average_pool": _average_pool,
    "conv2d": _conv2d,
    "max_pool": _max_pool,
    "residual": _residual,
}
