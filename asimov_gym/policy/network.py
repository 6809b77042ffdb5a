"""A policy file's network as a function over arrays of any library, for graphs that another program compiles.

`asimov_gym.policy.runner` runs the same file with onnxruntime; this module reads the graph instead, with the onnx
package, and computes it from array functions. It knows the operations of multilayer perceptrons with their normaliser,
and of networks that are symmetric by construction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from asimov_gym.policy.contract import PolicyContract
from asimov_gym.policy.runner import INPUT, OUTPUT, PolicyFileError, read_contract
from asimov_gym.policy.verification import verify_contract
from asimov_gym.robot.array_library import namespace


class PolicyNetwork:
    """A network that answers arrays of any array-API library with arrays of that library. Made by `read_network`."""

    def __init__(self, contract: PolicyContract, graph: Sequence[Any], constants: Mapping[str, np.ndarray]) -> None:
        self.contract = contract
        self.graph = graph
        """Its operations as ONNX nodes, in order."""
        self.constants = constants
        """Arrays that they take, by name."""

    def infer(self, observation: Any) -> Any:
        """Raw outputs (n, 23), float32, for observations (n, width)."""
        xp = namespace(observation)
        values: dict[str, Any] = {**self.constants, INPUT: xp.astype(observation, xp.float32)}
        for node in self.graph:
            inputs = [values[name] if name else None for name in node.input]
            values[node.output[0]] = OPERATIONS[node.op_type](xp, _attributes(node), *inputs)
        return values[OUTPUT]


def read_network(path: str | Path) -> PolicyNetwork:
    """The network of a policy file, ours or one exported by the robot's maker.

    Raises:
        FileNotFoundError: there is no such file.
        ModuleNotFoundError: the onnx package is missing.
        PolicyFileError: the file is not a policy, or its graph has an operation that is not known here.
        ContractError: the contract is malformed or the robot cannot honour it; names the field.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no policy file at {path}")
    try:
        import onnx
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "onnx is not installed, which reading a policy's weights needs: pip install 'asimov-gym[mjx]'"
        ) from error
    try:
        model = onnx.load(str(path))
    except Exception as error:  # the parser's exceptions share no public base class
        raise PolicyFileError(f"not an Asimov policy: {path} cannot be read as an ONNX model: {error}") from error
    contract = read_contract({entry.key: entry.value for entry in model.metadata_props}, path)
    verify_contract(contract)
    unknown = sorted({node.op_type for node in model.graph.node} - set(OPERATIONS))
    if unknown:
        raise PolicyFileError(
            f"{path}: the network has operations {unknown}, which cannot be read into a compiled graph; known "
            f"operations: {', '.join(OPERATIONS)}"
        )
    constants = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    return PolicyNetwork(contract, tuple(model.graph.node), constants)


def _attributes(node: Any) -> dict[str, Any]:
    import onnx

    return {entry.name: onnx.helper.get_attribute_value(entry) for entry in node.attribute}


# -- operations: (library, attributes, inputs) -> output. Shapes, places and the like are plain NumPy arrays.


def _gemm(xp: Any, at: Mapping[str, Any], a: Any, b: Any, c: Any = None) -> Any:
    a, b = xp.asarray(a), xp.asarray(b)
    a = xp.matrix_transpose(a) if at.get("transA", 0) else a
    b = xp.matrix_transpose(b) if at.get("transB", 0) else b
    product = xp.matmul(a, b)
    if at.get("alpha", 1.0) != 1.0:
        product = at["alpha"] * product
    return product if c is None else product + at.get("beta", 1.0) * xp.asarray(c)


def _elu(xp: Any, at: Mapping[str, Any], x: Any) -> Any:
    below = xp.expm1(xp.clip(x, None, 0.0))
    return xp.where(x > 0.0, x, at.get("alpha", 1.0) * below)


def _leaky_relu(xp: Any, at: Mapping[str, Any], x: Any) -> Any:
    return xp.where(x > 0.0, x, at.get("alpha", 0.01) * x)


def _gather_nd(xp: Any, at: Mapping[str, Any], x: Any, places: Any) -> Any:
    if at.get("batch_dims", 0) or places.shape[-1] != 1:
        raise PolicyFileError("GatherND is known only along the first axis of a network's tensors")
    return xp.take(x, xp.asarray(np.asarray(places)[..., 0]), axis=0)


def _slice(xp: Any, at: Mapping[str, Any], x: Any, starts: Any, ends: Any, axes: Any = None, steps: Any = None) -> Any:
    axes = range(len(starts)) if axes is None else np.asarray(axes)
    steps = np.ones(len(starts), dtype=int) if steps is None else np.asarray(steps)
    index = [slice(None)] * x.ndim
    for axis, start, end, step in zip(axes, np.asarray(starts), np.asarray(ends), steps, strict=True):
        index[int(axis)] = slice(int(start), int(end), int(step))
    return x[tuple(index)]


def _shape(xp: Any, at: Mapping[str, Any], x: Any) -> np.ndarray:
    return np.array(x.shape[at.get("start", 0) : at.get("end")], dtype=np.int64)


def _both(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """An operation on two tensors, of which one may be a constant."""
    return lambda xp, at, a, b: function(xp.asarray(a), xp.asarray(b))


OPERATIONS: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {
        "Add": _both(lambda a, b: a + b),
        "Clip": lambda xp, at, x, low=None, high=None: xp.clip(x, low, high),
        "Concat": lambda xp, at, *parts: xp.concat([xp.asarray(part) for part in parts], axis=at["axis"]),
        "Div": _both(lambda a, b: a / b),
        "Elu": _elu,
        "Gather": lambda xp, at, x, places: xp.take(x, xp.asarray(places), axis=at.get("axis", 0)),
        "GatherND": _gather_nd,
        "Gemm": _gemm,
        "Identity": lambda xp, at, x: x,
        "LeakyRelu": _leaky_relu,
        "MatMul": _both(lambda a, b: a @ b),
        "Mul": _both(lambda a, b: a * b),
        "Neg": lambda xp, at, x: -x,
        "Relu": lambda xp, at, x: xp.clip(x, 0.0, None),
        "Shape": _shape,
        "Sigmoid": lambda xp, at, x: 0.5 * (xp.tanh(0.5 * x) + 1.0),
        "Slice": _slice,
        "Sub": _both(lambda a, b: a - b),
        "Tanh": lambda xp, at, x: xp.tanh(x),
        "Transpose": lambda xp, at, x: xp.permute_dims(x, tuple(at.get("perm", range(x.ndim)[::-1]))),
    }
)
"""Known operations by their ONNX name."""
