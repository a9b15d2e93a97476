"""A run's folder: never overwritten silently, and found again by the command that made it.

config.yaml            the resolved config
checkpoints/last.ckpt  the last checkpoint, ending in its own SHA-256; before.ckpt: the one before
.lock                  locked while a process is at work here
events.*, hparams.yaml TensorBoard's
bundle/                the trained model
surrogate/             a run within the run, where the rig gives no gradients: the surrogate that was trained first
metrics.json           the errors of the evaluation; written last: its presence marks the run as finished
"""

import datetime
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml
from omegaconf import DictConfig, OmegaConf

from riginv.errors import InputError
from riginv.runs.checksums import has_valid_checksum, is_as_written, text_sha256, with_checksum
from riginv.runs.files import discard, read_yaml, stale_partial_files, write_text
from riginv.runs.locks import LOCK, lock_folder

CONFIG, METRICS, POSES, CHOICES = "config.yaml", "metrics.json", "poses.png", "hparams.yaml"
CHECKPOINT, CHECKPOINT_BEFORE = "checkpoints/last.ckpt", "checkpoints/before.ckpt"
BUNDLE, SURROGATE = "bundle", "surrogate"
NOT_PART_OF_A_RUN = ("resume", "verbose")
# Config keys that may differ when a run is resumed: results do not depend on them.
MAY_DIFFER_ON_RESUME = ("trainer.devices", "trainer.num_nodes", "trainer.threads", "pictures.final")
TIME, TIME_LENGTH = "%Y-%m-%d_%H-%M-%S", 19
LONGEST = 120  # characters of a folder's name
WAIT_SECONDS = 0.2


@dataclass(frozen=True)
class RunFolder:
    """The folder of one run.

    Attributes:
        path: of the folder.
        config: the plain config.
        resumed: whether the folder holds an earlier start of the same run, which continues.
        is_writer: whether this process writes the folder: rank 0.
        was_empty: whether the folder was empty or missing when it was chosen.
    """

    path: Path
    config: dict[str, Any]
    resumed: bool
    is_writer: bool = True
    was_empty: bool = False

    def begin(self) -> None:
        """Lock the folder, remove partial files of killed processes, and write config.yaml.

        Raises:
            InputError: another process uses the folder, or has begun a run there since.
        """
        if not self.is_writer:
            return
        if lock_folder(self.path) and self.was_empty and (self.path / CONFIG).is_file():
            raise InputError(f"{self.path}: another run has just begun there: choose another folder with hydra.run.dir=DIR")
        for left in (*self.path.rglob(".*.part"), self.path / CHOICES):  # the latter is TensorBoard's, and never mended by it
            discard(left)
        self._discard_damaged_checkpoints()
        if not self.resumed:
            write_text(self.path / CONFIG, with_checksum(yaml.safe_dump(self.config, sort_keys=False)))

    @property
    def checkpoint(self) -> Path | None:
        """The last valid checkpoint, or None."""
        paths = [self.path / name for name in (CHECKPOINT, CHECKPOINT_BEFORE)]
        return next((path for path in paths if path.is_file() and has_valid_checksum(path)), None)

    @property
    def finished(self) -> bool:
        try:
            return isinstance(json.loads((self.path / METRICS).read_text(encoding="utf-8")), dict)
        except (OSError, ValueError):  # not there, or damaged: it is made again
            return False

    def _discard_damaged_checkpoints(self) -> None:
        damaged = []
        for path in (self.path / CHECKPOINT, self.path / CHECKPOINT_BEFORE):
            if path.is_file() and has_valid_checksum(path):
                break
            if path.is_file():
                discard(path)
                damaged.append(str(path))
        if damaged:
            how = f"going on from {self.checkpoint}, the one before" if self.checkpoint else "training starts over"
            said = f"{', '.join(damaged)}: truncated or altered since it was written (SHA-256 differs)"
            print(f"{said}: {how}", file=sys.stderr, flush=True)

    def wait_until_finished(self) -> None:
        """Wait for the process that writes here."""
        while not self.finished:
            time.sleep(WAIT_SECONDS)


def find_run_folder(
    path: str | Path,
    config: dict[str, Any],
    resume: bool,
    is_writer: bool = True,
    upgrade: Callable[[dict[str, Any]], dict[str, Any]] = dict,
) -> RunFolder:
    """The folder for a run, new or to be resumed; nothing is written before `RunFolder.begin`.

    Args:
        config: as from `plain_config`.
        is_writer: whether this process writes there; other ranks take the folder as it is.
        upgrade: gives the config of a run to be resumed present names (`riginv.config.aliases.upgraded`).

    Raises:
        InputError: the folder holds something else, a run and `resume` is false, or a run of another config.
    """
    path = Path(path)
    if not is_writer:
        return RunFolder(path, config, resumed=True, is_writer=False)
    if not path.is_dir() or set(path.iterdir()) <= {path / LOCK, *stale_partial_files(path / CONFIG)}:
        return RunFolder(path, config, resumed=False, was_empty=True)
    if not (path / CONFIG).is_file():
        raise InputError(f"{path} holds files that are no run of riginv: choose another folder with hydra.run.dir=DIR")
    if not resume:
        raise InputError(f"{path} holds a run already: add resume=true to go on with it, or choose another hydra.run.dir=DIR")
    before, now = _flat(upgrade(_read_config(path / CONFIG))), _flat(config)
    differing = sorted(
        key for key in (before.keys() | now.keys()) - set(MAY_DIFFER_ON_RESUME) if before.get(key) != now.get(key)
    )
    if differing:
        key = differing[0]
        raise InputError(
            f"{path} cannot be resumed with another config: {key} was {before.get(key)!r}, now {now.get(key)!r}; "
            f"give the same arguments as before, or choose another hydra.run.dir=DIR"
        )
    return RunFolder(path, config, resumed=True)


def resolved(config: DictConfig) -> dict[str, Any]:
    """A config as plain values, its interpolations resolved.

    Raises:
        InputError: a value that must be given is not.
    """
    for key in sorted(OmegaConf.missing_keys(config)):
        raise InputError(f"{key} must be given: add {key}=...")
    return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))


def plain_config(config: DictConfig) -> dict[str, Any]:
    """The resolved config as plain values, without what may differ between two starts of one run.

    Raises:
        InputError: a value that must be given is not.
    """
    return {key: value for key, value in resolved(config).items() if key not in NOT_PART_OF_A_RUN}


def discard_if_empty(path: Path) -> None:
    """Remove a folder that a run was to use and did not, and those made for it."""
    for folder in (path, *path.parents):
        if not folder.is_dir() or any(folder.iterdir()) or folder.resolve() == Path.cwd():
            return
        folder.rmdir()


def register_folder_resolvers() -> None:
    """Register the resolvers `${run_folder:resume,name,arguments}` and `${folder_name:text}` of configs."""
    OmegaConf.register_new_resolver("run_folder", default_run_folder, replace=True, use_cache=True)
    OmegaConf.register_new_resolver("folder_name", folder_name, replace=True)


def default_run_folder(resume: bool, name: str, arguments: str) -> str:
    """`runs/NAME/TIME_ARGUMENTS`; with `resume` the latest unfinished one of the same name and arguments, if there is one."""
    parent, ending = Path("runs") / folder_name(name), f"_{folder_name(arguments)}" if arguments else ""
    if resume:
        same = sorted(path for path in parent.glob("*") if path.name[TIME_LENGTH:] == ending and (path / CONFIG).is_file())
        unfinished = [path for path in same if not (path / METRICS).is_file()]
        if same:
            return str((unfinished or same)[-1])
    return str(parent / (datetime.datetime.now().strftime(TIME) + ending))


def folder_name(text: str) -> str:
    """A text as a folder name: without separators, at most LONGEST characters, made unique by a hash if cut."""
    name = text.replace("/", "_").replace("\\", "_")
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 9]}~{text_sha256(text)[:8]}"


def _read_config(path: Path) -> dict[str, Any]:
    if not is_as_written(path.read_bytes().decode(errors="replace")):
        raise InputError(
            f"{path}: truncated or altered since it was written (SHA-256 differs): bring it back as it was, or choose another "
            f"folder with hydra.run.dir=DIR"
        )
    return read_yaml(path)


def _flat(config: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in config.items():
        flat.update(_flat(value, f"{prefix}{key}.") if isinstance(value, dict) and value else {f"{prefix}{key}": value})
    return flat
