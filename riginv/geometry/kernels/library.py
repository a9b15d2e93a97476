"""The compiled kernels, loaded or compiled on first use, and which tensors they can take."""

import contextlib
import ctypes
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor
from torch.autograd import forward_ad

from riginv.geometry.kernels.build import ENDING, LEVELS, CompilationError, compile_library, library_name, source_digest
from riginv.runs.cache import cache_folder

SWITCH = "RIGINV_KERNELS"  # environment variable: 0 turns the kernels off
SUFFIXES = {torch.float32: "f32", torch.float64: "f64"}
_pure: ContextVar[bool] = ContextVar("pure_torch", default=False)


class Kernels:
    """A loaded library.

    Args:
        path: of the shared library.

    Attributes:
        path: where it is.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ctypes.CDLL(str(path))  # calls release Python's lock, so threads run in parallel
        self.functions: dict[tuple[str, torch.dtype], Any] = {}

    def call(self, name: str, dtype: torch.dtype, *arguments: Tensor | int | None) -> int:
        """Call a kernel by its name in the source, in float32 or float64.

        Args:
            arguments: tensors are passed by the address of their first element.

        Returns:
            0, or a number above 1 with a meaning of the kernel's.
        """
        function = self.functions.get((name, dtype))
        if function is None:
            function = self.functions[name, dtype] = getattr(self.library, f"{name}_{SUFFIXES[dtype]}")
            function.restype = ctypes.c_int
            function.argtypes = [ctypes.c_int64 if isinstance(value, int) else ctypes.c_void_p for value in arguments]
        code = function(*[value.data_ptr() if isinstance(value, Tensor) else value for value in arguments])
        if code == 1:
            raise MemoryError(f"kernel {name}: out of memory")
        return code


@contextmanager
def pure_torch() -> Iterator[None]:
    """A context without kernels: for tracing, and for derivatives of derivatives."""
    token = _pure.set(True)
    try:
        yield
    finally:
        _pure.reset(token)


def kernels_for(*tensors: Tensor) -> Kernels | None:
    """The kernels, if they can take these tensors: on a CPU, all of float32 or all of float64, indices of int64; else None."""
    return kernels() if _are_plain(tensors, "is_cpu") else None


def gpu_kernels_for(*tensors: Tensor) -> bool:
    """Whether there are kernels for GPUs and they can take these tensors, as for `kernels_for`."""
    return _are_plain(tensors, "is_cuda") and os.environ.get(SWITCH) != "0" and find_spec("triton") is not None


def _are_plain(tensors: Sequence[Tensor], where: Literal["is_cpu", "is_cuda"]) -> bool:
    """Whether tensors are on such a device, all of float32 or all of float64, indices of int64, and nothing traces them."""
    if _pure.get() or is_transformed(tensors):
        return False
    dtype = tensors[0].dtype
    for tensor in tensors:
        if not getattr(tensor, where) or type(tensor) not in (Tensor, torch.nn.Parameter):
            return False
        if tensor.dtype != (dtype if tensor.is_floating_point() else torch.int64):
            return False
    return dtype in SUFFIXES


def is_transformed(tensors: Sequence[Tensor]) -> bool:
    """Whether tensors are part of a traced program, of a vmap or of forward-mode differentiation, which see no kernels."""
    if torch.compiler.is_compiling() or torch.jit.is_tracing() or torch._C._functorch.maybe_current_level() is not None:
        return True
    if torch._C._len_torch_dispatch_stack():  # make_fx, and tensors without values
        return True
    if not all(torch._C._has_storage(tensor) for tensor in tensors):  # torch.autograd's own vmap
        return True
    return forward_ad._current_level >= 0 and any(forward_ad.unpack_dual(tensor).tangent is not None for tensor in tensors)


def plain_rows(values: Tensor) -> Tensor:
    """Values `(batch, number)` without a graph, each row contiguous."""
    values = values.detach() if values.requires_grad else values
    return values if values.stride(-1) == 1 and values.stride(0) >= values.shape[-1] else values.contiguous()


def kernels() -> Kernels | None:
    """The kernels for this machine; None where they are turned off or cannot be compiled."""
    return None if os.environ.get(SWITCH) == "0" else _found()[0]


def why_not() -> str:
    """The reason why there are no kernels; empty where there are."""
    return f"{SWITCH}=0" if os.environ.get(SWITCH) == "0" else _found()[1]


@functools.cache
def _found() -> tuple[Kernels | None, str]:
    """The kernels, or the reason why there are none."""
    levels = [level for level in reversed(LEVELS) if _runs(level)]
    digest = source_digest()
    installed = [Path(__file__).parent / library_name(level) for level in levels]
    for path in [*installed, _compiled_here(levels[0], digest)]:
        if (found := _load(path, digest)) is not None:
            return found, ""
    path = _compiled_here(levels[0], digest)
    try:
        compile_library(path, levels[0])
    except (CompilationError, OSError) as error:
        return None, str(error)
    found = _load(path, digest)
    return found, "" if found else f"{path} cannot be loaded"


def _compiled_here(level: str, digest: str) -> Path:
    return cache_folder() / f"kernels-{digest}-{level}{ENDING}"


def _load(path: Path, digest: str) -> Kernels | None:
    """The library at a path, if it exists, belongs to this user or root, and was compiled from the present source."""
    if not path.is_file() or _is_foreign(path):
        return None
    with contextlib.suppress(OSError, AttributeError):
        found = Kernels(path)
        source = found.library.riginv_source
        source.restype = ctypes.c_char_p
        if (source() or b"").decode() == digest:
            return found
    return None


def _is_foreign(path: Path) -> bool:
    """Whether a file belongs to another user than root or this one: its code would run."""
    return hasattr(os, "getuid") and path.stat().st_uid not in (0, os.getuid())


def _runs(level: str) -> bool:
    """Whether the processor supports the instructions of a level."""
    return level == "plain" or torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512")


def pure_gradients(function: Callable[[Tensor], Tensor], given: Tensor, gradient: Tensor) -> Tensor:
    """The vector-Jacobian product of `function` at `given`, itself differentiable, without kernels."""
    with pure_torch(), torch.enable_grad():
        return torch.autograd.grad(function(given), given, gradient, create_graph=True)[0]
