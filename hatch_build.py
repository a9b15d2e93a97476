"""Compiles the CPU kernels while riginv is installed; where no C compiler is found, pip brings one for this step alone.

A wheel with kernels is for this platform; without them it is for any, and PyTorch computes what they would.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

KERNELS = Path(__file__).parent / "riginv" / "geometry" / "kernels"


class KernelBuildHook(BuildHookInterface):
    """Puts the compiled kernels beside their source."""

    def dependencies(self) -> list[str]:
        return ["ziglang>=0.13"] if self.target_name == "wheel" and _build().find_compiler() is None else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":
            return
        build = _build()
        for level in build.LEVELS:
            try:
                build.compile_library(KERNELS / build.library_name(level), level)
            except build.CompilationError as error:
                print(f"riginv: CPU kernels ({level}) were not compiled: {error}", file=sys.stderr)
                return
        if version != "editable":
            from packaging.tags import sys_tags

            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{next(iter(sys_tags())).platform}"
            build_data["artifacts"] += [f"riginv/geometry/kernels/compiled-*{build.ENDING}"]


def _build() -> ModuleType:
    """The module that compiles, without the package around it, whose dependencies are not there yet."""
    spec = importlib.util.spec_from_file_location("riginv_kernel_build", KERNELS / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
