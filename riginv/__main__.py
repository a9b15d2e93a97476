"""The console script `riginv COMMAND ...`: the same as `python -m riginv.COMMAND ...`."""

import difflib
import importlib.util
import os
import runpy
import sys

COMMANDS = {
    "train": "train a network on a rig and evaluate it on the true rig",
    "evaluate": "evaluate a trained model on the true rig, or one rig against another",
    "invert": "a clip of meshes in, animation curves out, with the error of every frame",
    "compare": "every method of rig inversion on the same meshes, in one table",
    "inspect": "what a clip, a trained model, a prior or a store of poses holds",
    "check": "check that a rig fulfils the contract that training relies on",
    "contact_sheet": "a picture of a rig: neutral, named poses, random poses",
    "sample": "sample poses of a rig into a store on disk",
    "export_onnx": "a trained inverse as an ONNX file",
    "learn_prior": "learn which controls occur together, from inverted takes",
    "markers": "where the markers of a take are on a rig, or where to put them",
    "missing": "the shapes that a rig lacks for a clip, with the controls that call for them",
    "wrap": "fit the mesh of a rig to a scan of a neutral face",
    "reproduce": "the tables, figures and claims of the paper in one report",
}


def main() -> None:
    """Run the command that the first argument names."""
    arguments = sys.argv[1:]
    if arguments[:1] in (["-sc"], ["--shell-completion"], ["--shell_completion"]):
        complete(arguments)
    elif not arguments or arguments[0] in ("-h", "--help", "help"):
        print(usage())
    elif arguments[0] == "--version":
        from riginv import __version__

        print(f"riginv {__version__}")
    else:
        sys.exit(run(*arguments))


def usage() -> str:
    """The text of `riginv --help`."""
    lines = [f"  {name:14} {text}" for name, text in COMMANDS.items()]
    return "\n".join(
        [
            "riginv COMMAND KEY=VALUE ...: meshes to rig controls, evaluated on the true rig",
            "",
            *lines,
            "",
            "riginv COMMAND --help explains its keys. riginv train rig=face model=inverse is a good start.",
            'Completion of commands, groups and keys in bash: eval "$(riginv -sc install=bash)" (or zsh, fish).',
        ]
    )


def run(name: str, *arguments: str) -> str | None:
    """Run a command as `python -m riginv.NAME` does; an error message where there is no such command."""
    command = name.replace("-", "_")
    if command not in COMMANDS:
        near = difflib.get_close_matches(command, COMMANDS, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known commands: {', '.join(COMMANDS)}"
        return f"error: riginv {name}: there is no such command; {hint}"
    module = f"riginv.{command}"
    specification = importlib.util.find_spec(module)
    is_package = specification is not None and specification.submodule_search_locations is not None
    if not {"", os.getcwd()} & {*sys.path}:
        sys.path.append(os.getcwd())  # rigs and methods of this folder, as for python -m; last, so that none hides a module
    sys.argv[:] = [sys.argv[0], *arguments]
    runpy.run_module(f"{module}.__main__" if is_package else module, run_name="__main__", alter_sys=True)
    return None


def complete(arguments: list[str]) -> None:
    """Answer a shell's completion: commands here, keys and groups by Hydra from the command's config alone, without torch."""
    words = os.environ.get("COMP_LINE", "").split(" ")
    if any(argument.startswith("query=") for argument in arguments) and len(words) <= 2:
        print(" ".join(name for name in COMMANDS if name.startswith(words[-1])))
        return
    import hydra

    from riginv.config.messages import CONFIGS

    known = len(words) > 2 and words[1] in COMMANDS
    os.environ["COMP_LINE"] = " ".join([words[0], *words[2:]])
    hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=words[1] if known else "train")(lambda config: None)()


if __name__ == "__main__":
    main()
