"""Running a policy file with onnxruntime alone: no torch, no JAX."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import onnxruntime

from asimov_gym.policy.contract import PolicyContract, clip_action
from asimov_gym.policy.field_checks import ContractError
from asimov_gym.policy.vendor_metadata import VERSION_KEY, contract_from_vendor, is_vendor_metadata, own_metadata
from asimov_gym.policy.verification import verify_contract

INPUT, OUTPUT = "obs", "actions"
_FLOAT = "tensor(float)"


class PolicyFileError(ValueError):
    """The file is not an Asimov policy: not an ONNX model, or one without a contract or with a foreign graph."""


@runtime_checkable
class Policy(Protocol):
    """A loaded network: what `load_policy` returns, or a stand-in for it."""

    contract: PolicyContract

    def infer(self, observation: np.ndarray) -> np.ndarray:
        """Raw outputs (n, 23) for observations (n, width)."""
        ...


class PolicyRunner:
    """A policy network and its contract. Made by `load_policy`."""

    def __init__(
        self, session: onnxruntime.InferenceSession, contract: PolicyContract, name: str = "", sha256: str = ""
    ) -> None:
        self.contract = contract
        self.name = name
        """Of its file."""
        self.sha256 = sha256
        """Of the file's bytes, hexadecimal: what a recording knows the network by."""
        self._session = session
        self._one_by_one = session.get_inputs()[0].shape[0] == 1

    def __deepcopy__(self, memo: dict[int, Any]) -> PolicyRunner:
        """Itself: a loaded network does not change, and Gymnasium copies the arguments of environments."""
        return self

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Actions for observations, clipped to the contract's `action_clip`; see `infer`."""
        return clip_action(self.contract, self.infer(observation))

    def infer(self, observation: np.ndarray) -> np.ndarray:
        """Outputs of the network as they are, float32.

        Args:
            observation: one vector (width,) or a batch (n, width).

        Returns:
            (23,) or (n, 23), policy order. A non-finite observation may give a non-finite
            row; the other rows are not touched by it.

        Raises:
            ValueError: wrong shape.
        """
        batch = np.ascontiguousarray(observation, dtype=np.float32)
        width = self.contract.observation.width
        if batch.ndim not in (1, 2) or batch.shape[-1] != width:
            raise ValueError(f"observation has shape {batch.shape}; the policy takes ({width},) or (n, {width})")
        rows = batch.reshape(-1, width)
        if self._one_by_one:
            outputs = [self._run(row[None]) for row in rows]
            actions = np.concatenate(outputs) if outputs else np.empty((0, len(self.contract.joint_names)), np.float32)
        else:
            actions = self._run(rows)
        return actions.reshape(*batch.shape[:-1], len(self.contract.joint_names))

    def _run(self, rows: np.ndarray) -> np.ndarray:
        return np.asarray(self._session.run([OUTPUT], {INPUT: rows})[0])


def load_policy(path: str | Path, *, verify: bool = True, strict: bool = False) -> PolicyRunner:
    """Load a policy file, ours or one exported by the robot's maker.

    Args:
        path: ONNX file with a contract in its metadata.
        verify: check that this robot can honour the contract; without it the policy can be looked at, not trusted.
        strict: refuse a policy trained on another robot model, instead of warning.

    Raises:
        FileNotFoundError: there is no such file.
        PolicyFileError: the file is not an ONNX model, has no contract, or its graph is not one of a policy.
        ContractError: the contract is malformed or the robot cannot honour it; names the field.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no policy file at {path}")
    session = _open(path)
    contract = read_contract(session.get_modelmeta().custom_metadata_map, path)
    _check_graph(session, contract, path)
    if verify:
        verify_contract(contract, strict=strict)
    runner = PolicyRunner(session, contract, path.name, hashlib.sha256(path.read_bytes()).hexdigest())
    _check_output(runner, path)
    return runner


def read_contract(metadata: Mapping[str, str], source: str | Path) -> PolicyContract:
    """Contract in the metadata of a policy file, in our schema or the maker's.

    Args:
        metadata: the file's metadata.
        source: the file, for messages.

    Raises:
        PolicyFileError: neither schema is there.
        ContractError: the contract is malformed; names the field.
    """
    if is_vendor_metadata(metadata):
        return contract_from_vendor(metadata)
    if "schema_version" not in metadata:
        found = ", ".join(sorted(metadata)) or "none"
        raise PolicyFileError(
            f"not an Asimov policy: the metadata of {source} has neither `schema_version` nor `{VERSION_KEY}` "
            f"(keys found: {found}). Export it with `python -m train export`."
        )
    return PolicyContract.from_metadata(own_metadata(metadata))


def _open(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    # The network is small: threads cost more than they give, and would fight the physics for the cores.
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no public base class
        raise PolicyFileError(f"not an Asimov policy: {path} cannot be opened as an ONNX model: {error}") from error


def _check_graph(session: onnxruntime.InferenceSession, contract: PolicyContract, path: Path) -> None:
    """Raise an error unless the graph maps `obs` (n, width) to `actions` (n, 23), both float32."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if [entry.name for entry in inputs] != [INPUT] or OUTPUT not in [entry.name for entry in outputs]:
        raise PolicyFileError(
            f"not an Asimov policy: {path} maps {[i.name for i in inputs]} to {[o.name for o in outputs]}; "
            f"it must map one input {INPUT!r} to {OUTPUT!r} (recurrent networks are not supported)"
        )
    output = next(entry for entry in outputs if entry.name == OUTPUT)
    _check_tensor(INPUT, inputs[0], contract.observation.width, "observation")
    _check_tensor(OUTPUT, output, len(contract.joint_names), "joint_names")
    batch = inputs[0].shape[0]
    if isinstance(batch, int) and batch != 1:
        raise PolicyFileError(
            f"not an Asimov policy: {path} takes batches of exactly {batch}; only free or 1 can be run"
        )


def _check_tensor(name: str, tensor: Any, width: int, field: str) -> None:
    if tensor.type != _FLOAT or len(tensor.shape) != 2:
        raise PolicyFileError(
            f"not an Asimov policy: {name!r} is {tensor.type} {tensor.shape}, not {_FLOAT} (n, {width})"
        )
    if isinstance(tensor.shape[1], int) and tensor.shape[1] != width:
        raise ContractError(field, f"{width} entries", f"{tensor.shape[1]}, the width of the graph's {name!r}")


def _check_output(runner: PolicyRunner, path: Path) -> None:
    """Run the network once, on zeros: its output must have the right shape and be finite."""
    width = runner.contract.observation.width
    try:
        output = runner.infer(np.zeros(width, dtype=np.float32))
    except Exception as error:  # as in _open; also a graph whose output cannot be reshaped to one value per joint
        raise PolicyFileError(f"not an Asimov policy: {path} fails on a zero observation: {error}") from error
    if not np.isfinite(output).all():
        raise PolicyFileError(f"not an Asimov policy: {path} answers a zero observation with non-finite actions")
