"""The contract of the rig interface: `check_rig(rig)` in a test, or `python -m riginv.check`."""

import copy
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend

MM, OF_SIZE = 1e-3, 1e-6  # tolerance of meshes that should be equal, mm; of large rigs, relative to their size
POSES = 5
PROBES = 4  # random directions in which gradients are checked: a Jacobian of all vertices would take minutes


class ContractError(AssertionError):
    """A rig does not meet the contract; the message names the clause and the values."""


def check_rig(rig: RigBackend, seed: int = 0) -> None:
    """Check a rig against the contract.

    Raises:
        ContractError: it breaks it.
    """
    for _, check in contract(rig, seed):
        check()


def contract(rig: RigBackend, seed: int = 0) -> Iterator[tuple[str, Callable[[], None]]]:
    """The clauses of the contract, each with a check that raises `ContractError` where it does not hold."""
    controls = random_controls(rig, POSES, seed)
    yield "neutral controls give the rest mesh", lambda: _neutral(rig)
    yield "a batch of n poses equals n single poses", lambda: _batch(rig, controls)
    yield "the same controls give the same mesh", lambda: _same(rig, controls)
    yield "every limit gives a finite mesh", lambda: _limits(rig)
    yield "dtype and device follow the input", lambda: _dtype(rig, controls)
    if isinstance(rig, LinearRig):
        yield "vertices are the coefficients times the basis", lambda: _linear(rig, controls)
    if rig.differentiable:
        yield "gradients equal finite differences in float64", lambda: _gradients(rig, controls)


def random_controls(rig: RigBackend, count: int, seed: int) -> Tensor:
    """Controls `(count, control)`, uniform within the limits, kept off the limits themselves."""
    fraction = torch.rand(count, len(rig.controls), generator=generator_at(seed, "contract"), dtype=torch.float64)
    fraction = (0.02 + 0.96 * fraction).to(rig.lower)
    return rig.lower + fraction * (rig.upper - rig.lower)


def _tolerance(rig: RigBackend) -> float:
    """The distance below which meshes count as equal, mm: float32 keeps seven digits."""
    return max(MM, OF_SIZE * float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).max()))


def _expect(holds: bool, rig: RigBackend, message: str) -> None:
    if not holds:
        raise ContractError(f"rig '{rig.name}': {message}")


@torch.no_grad()
def _neutral(rig: RigBackend) -> None:
    found = rig(rig.neutral_controls[None])
    expected = (1, *rig.rest_vertices.shape)
    _expect(found.shape == expected, rig, f"forward gave shape {tuple(found.shape)} for one pose, expected {expected}")
    distance = (found[0] - rig.rest_vertices).norm(dim=1).max()
    _expect(bool(distance <= _tolerance(rig)), rig, f"neutral controls move a vertex {distance:.4g} mm from the rest mesh")


@torch.no_grad()
def _batch(rig: RigBackend, controls: Tensor) -> None:
    difference = (rig(controls) - torch.cat([rig(row[None]) for row in controls])).abs().max()
    _expect(
        bool(difference <= _tolerance(rig)), rig, f"poses in a batch differ by {difference:.4g} mm from the same poses alone"
    )


@torch.no_grad()
def _same(rig: RigBackend, controls: Tensor) -> None:
    difference = (rig(controls) - rig(controls)).abs().max()
    _expect(bool(difference == 0), rig, f"evaluated twice, the same controls differ by {difference:.4g} mm")


@torch.no_grad()
def _limits(rig: RigBackend) -> None:
    for name, controls in (("lower", rig.lower), ("upper", rig.upper)):
        _expect(bool(rig(controls[None]).isfinite().all()), rig, f"NaN or infinite vertices at the {name} limits")


@torch.no_grad()
def _dtype(rig: RigBackend, controls: Tensor) -> None:
    for dtype in (torch.float32, torch.float64):
        found = rig(controls.to(dtype))
        _expect(found.dtype == dtype, rig, f"{dtype} controls gave {found.dtype} vertices")
        _expect(found.device == controls.device, rig, f"controls on {controls.device} gave vertices on {found.device}")


@torch.no_grad()
def _linear(rig: LinearRig, controls: Tensor) -> None:
    coefficients = rig.coefficients(controls)
    expected = (len(controls), len(rig.basis))
    _expect(coefficients.shape == expected, rig, f"coefficients of shape {tuple(coefficients.shape)}, expected {expected}")
    _expect(len(rig.coefficient_names) == len(rig.basis), rig, "as many coefficient names as coefficients are needed")
    change = torch.einsum("bk,kvc->bvc", coefficients - rig.neutral_coefficients(), rig.basis)
    difference = (rig.rest_vertices + change - rig(controls)).abs().max()
    _expect(bool(difference <= _tolerance(rig)), rig, f"coefficients times basis lie {difference:.4g} mm from the vertices")


def _gradients(rig: RigBackend, controls: Tensor) -> None:
    precise = copy.deepcopy(rig).double()
    generator = generator_at(0, "probes")
    probes = torch.randn(PROBES, rig.rest_vertices.numel(), generator=generator, dtype=torch.float64).to(rig.device)
    probes = probes.T / rig.rest_vertices.numel() ** 0.5
    linear = precise if isinstance(precise, LinearRig) and type(precise).forward is LinearRig.forward else None
    of_basis = probes if linear is None else linear.basis.flatten(1) @ probes

    def probed(values: Tensor) -> Tensor:  # vertices that are linear in the coefficients need not be computed
        return (precise(values).flatten(1) if linear is None else linear.coefficients(values)) @ of_basis

    inputs = controls[:2].double().requires_grad_()
    try:
        torch.autograd.gradcheck(probed, (inputs,), eps=1e-6, atol=1e-4, rtol=1e-3, nondet_tol=0.0)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise ContractError(f"rig '{rig.name}' has differentiable=True, but its gradients are wrong: {reason}") from error
