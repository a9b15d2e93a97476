"""The texts of --help: a command's keys as its own YAML explains them."""

from omegaconf import OmegaConf

from riginv.config.messages import CONFIGS

READING = {"reading": "reading/default.yaml", "frames": "frames/all.yaml"}  # groups of every command that reads a clip


def register_help_resolvers() -> None:
    """Let a help text say `${explained_keys:COMMAND}` and `${group_choices:GROUP}`."""
    OmegaConf.register_new_resolver("explained_keys", explained_keys, replace=True, use_cache=True)
    OmegaConf.register_new_resolver("group_choices", group_choices, replace=True, use_cache=True)


def explained_keys(command: str) -> str:
    """The keys of `conf/COMMAND.yaml`, and of how it reads a clip, with their values and comments."""
    lines = _lines(f"{command}.yaml")
    head = lines.index("defaults:")
    body = next(number for number, line in enumerate(lines[head + 1 :], head + 1) if not line.startswith(" "))
    shared = [line for line in _lines("run/sweep.yaml") if line.startswith("verbose:")]  # keys of every command
    reading = [row for group in READING if f"  - {group}:" in "\n".join(lines[head:body]) for row in _group_keys(group)]
    return "\n".join(f"  {line}".rstrip() for line in [*lines[body:], *shared, *reading]).strip("\n")


def _group_keys(group: str) -> list[str]:
    """The keys of a group's only choice that have a comment, below the group's name."""
    about, *keys = _lines(READING[group])
    return [f"{group + ':':25} {about}", *(f"  {line}" for line in keys if " # " in line)]


def group_choices(group: str) -> str:
    """The choices of a group, by name."""
    return ", ".join(sorted(path.stem for path in (CONFIGS / group).glob("*.yaml")))


def _lines(name: str) -> list[str]:
    return (CONFIGS / name).read_text(encoding="utf-8").splitlines()
