"""The machine and the versions of a reproduction."""

import importlib.metadata
import os
import platform
from pathlib import Path

import torch

DISTRIBUTIONS = ("torch", "numpy", "scipy", "lightning")  # that figures depend on


def versions() -> dict[str, str]:
    """Versions of the distributions that take part."""
    names = ("riginv", *DISTRIBUTIONS, "hydra-core", "matplotlib", "jinja2", "bpy")
    return {name: version_of(name) for name in names}


def version_of(distribution: str) -> str:
    """The version of a distribution; `-`: it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "-"


def hardware() -> dict[str, str]:
    """Descriptions of processor, cores, memory, accelerator, system and Python."""
    facts = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "memory": _memory(),
        "accelerator": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "system": platform.platform(),
        "python": platform.python_version(),
    }
    return {name: value for name, value in facts.items() if value}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _memory() -> str:
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return ""
    return f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 1e9:.0f} GB"
