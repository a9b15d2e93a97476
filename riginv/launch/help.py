"""The texts of --help: a command's keys with the comments of its YAML."""

from omegaconf import OmegaConf

from riginv.config.messages import CONFIGS


def register_help_resolvers() -> None:
    """Register the resolvers `${explained_keys:COMMAND}` and `${group_choices:GROUP}` of help texts."""
    OmegaConf.register_new_resolver("explained_keys", explained_keys, replace=True, use_cache=True)
    OmegaConf.register_new_resolver("group_choices", group_choices, replace=True, use_cache=True)


def explained_keys(command: str) -> str:
    """The keys of `conf/COMMAND.yaml` with their values and comments, verbatim."""
    lines = _lines(f"{command}.yaml")
    head = lines.index("defaults:")
    body = next(number for number, line in enumerate(lines[head + 1 :], head + 1) if not line.startswith(" "))
    shared = [line for line in _lines("run/sweep.yaml") if line.startswith("verbose:")]  # keys of every command
    return "\n".join(f"  {line}".rstrip() for line in [*lines[body:], *shared]).strip("\n")


def group_choices(group: str) -> str:
    """The choices of a group, by name."""
    return ", ".join(sorted(path.stem for path in (CONFIGS / group).glob("*.yaml")))


def _lines(name: str) -> list[str]:
    return (CONFIGS / name).read_text(encoding="utf-8").splitlines()
