"""python -m riginv.export_onnx: a trained inverse as one ONNX file, compared with itself in onnxruntime."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "export_onnx")  # before the imports that take seconds

import contextlib
import importlib.util
import io
import json
import logging
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from rich.console import Console
from torch import Tensor, nn

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.config.values import PositiveInt
from riginv.errors import InputError
from riginv.geometry.curves import fixed_iterations
from riginv.inference.inverse import Inverse, load_inverse
from riginv.rig.batches import generator_at
from riginv.rig.interface import RigBackend
from riginv.rig.random_controls import sparse_controls
from riginv.runs.files import atomic_write, discard, free_file
from riginv.runs.locks import exclusive_lock
from riginv.runs.tables import new_table

OPSET = 18
TRACED = 11  # meshes: a number that nothing else in a rig is likely to have, which would be taken for it
LARGEST_DIFFERENCE = 1e-4  # of the mesh's size, of any vertex, between what the rig makes of both answers


@dataclass(frozen=True)
class ExportConfig:
    """The config of `riginv.export_onnx`; conf/export_onnx.yaml explains each key."""

    rig: ClassSpec[RigBackend] | None
    bundle: str
    out: str
    poses: PositiveInt


@dataclass(frozen=True)
class Parity:
    """The differences between the file's controls and the inverse's, on random poses of the rig.

    Attributes:
        control_fraction: the largest difference of any control, as a share of its range.
        vertex_mm: the largest distance of any vertex of the meshes that the rig makes of both.
        torch_ms, onnx_ms: what one mesh takes, in a batch.
    """

    control_fraction: float
    vertex_mm: float
    torch_ms: float
    onnx_ms: float


def export_onnx(config: DictConfig) -> None:
    """Write `config.out` from `config.bundle`, and print the comparison."""
    settings = to_typed(config, ExportConfig)
    out = free_file(settings.out, ".onnx")
    check_packages()
    inverse = load_inverse(settings.bundle, settings.rig.build() if settings.rig else None)
    console = Console()
    with (
        exclusive_lock(out),
        console.status("tracing the network, through the rig's own derivative where it has one; up to minutes"),
    ):
        parity = write_onnx(out, inverse, settings.poses)
    headings = ["", "largest difference\nof a vertex", "of a control,\nof its range", "a mesh in\nPyTorch", "in onnx-\nruntime"]
    table = new_table(headings, f"{out}: {out.stat().st_size / 1e6:.1f} MB")
    times = [f"{ms:.2f} ms" for ms in (parity.torch_ms, parity.onnx_ms)]
    table.add_row(f"{settings.poses} random poses", f"{parity.vertex_mm:.5f} mm", f"{parity.control_fraction:.1e}", *times)
    console.print(table)
    console.print(
        "vertices (mesh, vertex, 3) in mm -> controls (mesh, control); names and limits are in its metadata", style="dim"
    )


def check_packages() -> None:
    """Raises InputError where a required package is missing."""
    missing = [name for name in ("onnx", "onnxscript", "onnxruntime") if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(f"ONNX takes the packages {', '.join(missing)}: pip install 'riginv[onnx]'")


def write_onnx(path: Path, inverse: Inverse, poses: int = 64) -> Parity:
    """Write an inverse as ONNX: `vertices` `(mesh, vertex, 3)`, mm, to `controls` `(mesh, control)`.

    The rig's own derivative, which a staged network looks at, is in it; solver steps after the network are not.

    Raises:
        InputError: the rig gives no gradients and the network needs them, the network cannot be traced, or the file's answers
            are not the network's; nothing is written then.
    """
    meshes = random_meshes(inverse, max(poses, TRACED))
    program = _program(inverse, meshes[:TRACED])
    program.model.metadata_props.update(_metadata(inverse))
    with atomic_write(path) as beside:
        named = beside.with_name(f"{beside.name}.onnx")
        try:
            with _without_output():
                program.save(named, external_data=False)
            parity = compare(named, inverse, meshes[:poses])
            _check_parity(path, parity, inverse)
            named.replace(beside)
        finally:
            discard(named)
    return parity


def _check_parity(path: Path, parity: Parity, inverse: Inverse) -> None:
    rest = inverse.rig.rest_vertices
    allowed = LARGEST_DIFFERENCE * float((rest.amax(dim=0) - rest.amin(dim=0)).max())
    if not parity.vertex_mm <= allowed:
        raise InputError(
            f"{path}: not written: onnxruntime's answers differ from PyTorch's by up to {parity.vertex_mm:.3g} mm, "
            f"expected at most {allowed:.2g}; use the bundle in Python instead"
        )


@torch.no_grad()
def random_meshes(inverse: Inverse, count: int) -> Tensor:
    """Random poses of the inverse's rig, `(mesh, vertex, 3)`, mm."""
    rig = inverse.rig
    limits = rig.lower, rig.upper, rig.neutral_controls
    return rig(sparse_controls(*limits, len(rig.controls), count, generator_at(0, "onnx")))


def compare(path: Path, inverse: Inverse, meshes: Tensor) -> Parity:
    """Run a file in onnxruntime on meshes `(mesh, vertex, 3)`, one by one and all at once, and compare."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = torch.get_num_threads()
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    given = meshes.cpu().numpy()
    found, onnx_ms = _timed(lambda: session.run(["controls"], {"vertices": given})[0], len(meshes))
    _, torch_ms = _timed(lambda: inverse(meshes), len(meshes))
    own = inverse.network(inverse.network.rig.space.encode(meshes)).detach()  # encoded exactly, as in the file
    single = session.run(["controls"], {"vertices": given[:1]})[0]
    rig, found = inverse.rig, torch.tensor(found).to(own)
    difference = torch.maximum((found - own).abs().amax(dim=0), (torch.tensor(single).to(own) - own[:1]).abs().amax(dim=0))
    with torch.no_grad():
        apart = (rig(found) - rig(own)).norm(dim=2).max()
    return Parity(float((difference / (rig.upper - rig.lower)).max()), float(apart), torch_ms, onnx_ms)


class _Plain(nn.Module):
    """The inverse as a module from meshes to controls alone."""

    def __init__(self, inverse: Inverse) -> None:
        super().__init__()
        self.network = inverse.network

    def forward(self, coordinates: Tensor) -> Tensor:
        return self.network(coordinates).detach()


class _Whole(nn.Module):
    """The encoding of meshes, followed by a traced network."""

    rest: Tensor
    frame: Tensor

    def __init__(self, inverse: Inverse, traced: nn.Module) -> None:
        super().__init__()
        space = inverse.network.rig.space
        self.register_buffer("rest", space.rest_vertices.flatten())
        self.register_buffer("frame", space.directions.flatten(1).T.contiguous())
        self.traced = traced

    def forward(self, vertices: Tensor) -> Tensor:
        return self.traced((vertices.flatten(1) - self.rest) @ self.frame)


def _program(inverse: Inverse, meshes: Tensor) -> Any:
    """The ONNX program: the network is traced together with the derivative that it takes of the rig, then exported."""
    from torch.fx.experimental.proxy_tensor import make_fx

    coordinates = inverse.network.rig.space.encode(meshes)
    try:
        with fixed_iterations(), torch.enable_grad(), _without_output():
            traced = make_fx(_Plain(inverse), tracing_mode="symbolic", _allow_non_fake_inputs=True)(coordinates)
            _replace_unsupported(traced.graph)
            traced.graph.eliminate_dead_code()
            traced.recompile()
            dynamic = ({0: torch.export.Dim("mesh", min=1)},)
            program = torch.export.export(_Whole(inverse, traced), (meshes,), dynamic_shapes=dynamic, strict=False)
            return torch.onnx.export(
                program,
                input_names=["vertices"],
                output_names=["controls"],
                dynamo=True,
                opset_version=OPSET,
                optimize=False,
                verbose=False,
            )
    except (RuntimeError, ValueError, TypeError, AssertionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"this inverse of rig '{inverse.rig.name}' cannot be traced into ONNX: {reason}; a network that does not look at "
            f"the rig can be (model/network=direct)"
        ) from error


def _replace_unsupported(graph: Any) -> None:
    """Replace operations that the exporter does not support: a clamp between 0 and 0.5, and `hypot`."""
    aten = torch.ops.aten
    for node in list(graph.nodes):
        if node.target is aten.clamp.default and any(isinstance(limit, float) for limit in node.args[1:]):
            node.args = (node.args[0], *(None if limit is None else float(limit) for limit in node.args[1:]))
        if node.target is aten.hypot.default:
            with graph.inserting_before(node):
                squares = [graph.call_function(aten.mul.Tensor, (side, side)) for side in node.args]
                length = graph.call_function(aten.sqrt.default, (graph.call_function(aten.add.Tensor, tuple(squares)),))
            node.replace_all_uses_with(length)
            graph.erase_node(node)


def _metadata(inverse: Inverse) -> dict[str, str]:
    rig = inverse.rig
    return {"rig": rig.name, "unit": "mm", "controls": json.dumps([vars(control) for control in rig.controls])}


def _timed(work: Any, count: int) -> tuple[Any, float]:
    work()
    start = time.perf_counter()
    result = work()
    return result, 1000 * (time.perf_counter() - start) / count


@contextlib.contextmanager
def _without_output() -> Any:
    """A context without the exporters' output and warnings."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)


if __name__ == "__main__":
    command("export_onnx")(export_onnx)()
