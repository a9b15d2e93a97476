"""Limits for untrusted stages: the layers that they may reference, and memory."""

import sys
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf

from rigs.blender.in_blender.worker import RefusedError

MOST_LAYERS = 1000


def refuse_layers_elsewhere(file: str) -> list[str]:
    """Check that all layers of a stage are in its folder; none is fetched, and no device or pipe is opened.

    Returns:
        Missing assets.

    Raises:
        RefusedError: a layer is elsewhere, or there are too many.
    """
    root = Path(file).resolve()
    waiting, seen, missing = [str(root)], set(), []
    while waiting:
        identifier = waiting.pop()
        seen.add(identifier)
        if len(seen) > MOST_LAYERS:
            raise RefusedError(f"{file}: made of more than {MOST_LAYERS} layers: flatten it with usdcat --flatten")
        layer = Sdf.Layer.FindOrOpen(identifier)
        for asset in _assets_of(layer) if layer else ():
            name = asset.partition(":SDF_FORMAT_ARGS:")[0]
            target = _target_of(Path(_outer(identifier)).parent, name)
            if target is None or not target.is_relative_to(root.parent) or (target.exists() and not target.is_file()):
                raise RefusedError(
                    f"{file}: it refers to {asset[:80]!r}, expected layers in its own folder: flatten it with usdcat --flatten"
                )
            paths = [str(target)] if target.is_file() else []
            packed = Sdf.ComputeAssetPathRelativeToLayer(layer, name)
            if Ar.IsPackageRelativePath(packed):
                paths.append(packed)
            elif not paths:
                missing.append(asset)
            waiting += [one for one in paths if one not in seen]
    return missing


def limit_memory(most: int) -> None:
    """Limit the address space of this process, on Linux."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _target_of(folder: Path, name: str) -> Path | None:
    """The file of an asset, or the package that contains it; None where it is no plain path."""
    path = _outer(name)
    return None if "\0" in path or ":" in path else (folder / path).resolve()


def _outer(path: str) -> str:
    """The package of a package-relative path, else the path itself."""
    return Ar.SplitPackageRelativePathOuter(path)[0] if Ar.IsPackageRelativePath(path) else path


def _assets_of(layer: Sdf.Layer) -> list[str]:
    """Assets of a layer: sublayers, references, payloads and value clips."""
    found = list(layer.GetCompositionAssetDependencies())

    def visit(path: Sdf.Path) -> None:
        spec = layer.GetObjectAtPath(path)
        if isinstance(spec, Sdf.PrimSpec) and spec.HasInfo("clips"):
            found.extend(_paths_in(spec.GetInfo("clips")))

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return [asset for asset in found if asset]


def _paths_in(value: Any) -> list[str]:
    """The asset paths in the metadata of value clips."""
    if isinstance(value, Sdf.AssetPath):
        return [value.path]
    if isinstance(value, dict):
        return [path for inner in value.values() for path in _paths_in(inner)]
    if isinstance(value, list | tuple | Sdf.AssetPathArray):
        return [path for inner in value for path in _paths_in(inner)]
    return []
