"""The default inverse on one rig after another: a table of what it reaches on each.

    python -m benchmarks.other_rigs FOLDER ... [--out runs/other_rigs] [--steps 1000] [--seeds 0 1 2] [--set KEY=VALUE ...]

A folder holds `rigs.yaml`, in which every rig has a name; `python -m benchmarks.rig_list FOLDER` writes such a folder:

    fox:
      about: a quadruped of 49 joints, made of tubes
      licence: MIT (riginv)
      overrides: [rig=gltf, rig.file=fox.glb, rig.joints=true]   # of riginv.train
      takes:                                                     # clips to evaluate on; optional
        gait: [capture=fox.glb]

Paths in it are relative to the folder. Each training runs in a process of its own, and so does the evaluation on each take
after the first, which training itself evaluates on. What has finished is not run again, what was stopped goes on. The table is
OUT/other_rigs.csv and OUT/other_rigs.md: means over the seeds.
"""

import argparse
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.inference.inverse import Inverse, load_inverse
from riginv.launch.job_process import Job, run_in_subprocess
from riginv.launch.sweep_record import FINISHED
from riginv.launch.sweep_rows import shown
from riginv.rig.interface import RigBackend
from riginv.runs.files import read_json, read_yaml, write_text
from riginv.runs.run_folder import CONFIG, METRICS
from riginv.runs.tables import EXACT, SETS, WITHIN_REACH_MM, csv_text, markdown_text, sets_of

NAME = "other_rigs"
FIGURES = {  # key of metrics.json: heading
    "mean_vertex_error_mm": "mean error, mm",
    "neutral_mean_vertex_error_mm": "neutral, mm",
    "optimum_ratio": "x optimum",
    "control_precision": "precision",
    "control_recall": "recall",
    "roughness": "roughness",
}
FACTS = {"controls": "controls", "coefficients": "coefficients", "vertices": "vertices", "steps": "steps", "seeds": "seeds"}
BATCH_SIZE, ROUNDS = 64, 12


@dataclass(frozen=True)
class Entry:
    """A rig of a list.

    Attributes:
        folder: where its list lies, and where its commands run.
        overrides: of riginv.train.
        takes: of each take, by its name: overrides that choose it, such as `capture=take.csv`.
    """

    name: str
    folder: Path
    overrides: tuple[str, ...]
    about: str
    licence: str
    takes: Mapping[str, Sequence[str]]


def read_list(folder: Path) -> list[Entry]:
    """The rigs of a folder's `rigs.yaml`.

    Raises:
        InputError: the file is missing or damaged, or a rig lacks a field or has another than those of the list's format.
    """
    path, entries = folder / "rigs.yaml", []
    for name, fields in read_yaml(path).items():
        known = {"overrides": list, "about": str, "licence": str, "takes": dict}
        given = {"takes": {}, **(fields if isinstance(fields, dict) else {})}
        wrong = [key for key in known.keys() | given.keys() if not isinstance(given.get(key), known.get(key, ()))]
        if wrong:
            raise InputError(f"{path}: {name}: {wrong[0]} is {given.get(wrong[0])!r}, expected {', '.join(known)} of each rig")
        takes = {str(take): tuple(map(str, values)) for take, values in given["takes"].items()}
        overrides = tuple(map(str, given["overrides"]))
        entries.append(Entry(str(name), folder.resolve(), overrides, given["about"], given["licence"], takes))
    return entries


def run_entry(entry: Entry, out: Path, seed: int, extra: Sequence[str]) -> tuple[Path, dict[str, Any]] | None:
    """Train on a rig and evaluate on all of its takes: the run's folder and all metrics; None: something failed."""
    first, *others = entry.takes or [""]
    name = f"{entry.name}_seed-{seed}"
    training = [*entry.overrides, *extra, f"seed={seed}", *entry.takes.get(first, ())]
    if not _run("train", training, out, name, entry.folder):
        return None
    metrics = read_json(out / name / METRICS)
    metrics = {key.replace("capture/", f"{first}/"): value for key, value in metrics.items()}
    for take in others:
        of_rig = [text for text in entry.overrides if text.startswith("--") or text.split("=")[0].split(".")[0] == "rig"]
        evaluation = [*of_rig, f"bundle={out / name}", "poses=16", *entry.takes[take]]
        if not _run("evaluate", evaluation, out, f"{name}_{take}", entry.folder):
            return None
        found = read_json(out / f"{name}_{take}" / METRICS)
        metrics |= {key.replace("capture/", f"{take}/"): value for key, value in found.items() if key.startswith("capture/")}
    return out / name, metrics


def _run(command: str, arguments: list[str], out: Path, name: str, folder: Path) -> bool:
    """Run a command of riginv in a subprocess, unless it has finished already; whether it has finished."""
    given = [*arguments, f"hydra.run.dir={out / name}"]
    job = Job(f"riginv.{command}", given, out, 0, name, arguments, folder, can_resume=True)
    before = job.record()
    if before.starts and before.swept != arguments:
        raise InputError(f"{out / name} holds a run with other settings, {' '.join(before.swept)}: choose another --out")
    run_in_subprocess(job, threads=torch.get_num_threads())
    record = job.record()
    print(f"{name}: {record.state} {record.why}", flush=True)
    return record.state == FINISHED


def load(run: Path, folder: Path) -> Inverse:
    """The inverse of a run, whose rig may be a class of somebody's own."""
    config = read_yaml(run / CONFIG)["rig"]
    with chdir(folder):
        own = None if config["_target_"].startswith("rigs.") else ClassSpec.read(config, RigBackend).build()
        return load_inverse(run, own)


@torch.no_grad()
def facts_of(inverse: Inverse) -> dict[str, float]:
    """The size of a rig, and the frames a second of its inverse, full meshes in, controls out."""
    rig, limits = inverse.rig, (inverse.rig.upper - inverse.rig.neutral_controls)
    vertices = rig(rig.neutral_controls + 0.3 * limits * torch.rand(BATCH_SIZE, len(limits)))
    seconds = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        inverse(vertices)
        seconds.append(time.perf_counter() - began)
    size = {"controls": len(rig.controls), "coefficients": len(rig.basis), "vertices": len(rig.rest_vertices)}
    return {**size, "frames_per_s": BATCH_SIZE / statistics.median(seconds[2:])}


def rows_of(entry: Entry, facts: Mapping[str, float], runs: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """A row for each evaluation set of a rig: means over its runs."""
    size = {**facts, "steps": runs[0]["train/steps"], "seeds": len(runs)}
    for name in sets_of(runs[0]):
        row = {"rig": entry.name, "set": SETS.get(name, (name,))[0], **size, "licence": entry.licence}
        for key in (*FIGURES, "optimum_mean_vertex_error_mm"):
            values = [run[f"{name}/{key}"] for run in runs if run.get(f"{name}/{key}") is not None]
            row |= {key: statistics.mean(values), f"{key}_least": min(values), f"{key}_most": max(values)} if values else {}
        if row.get("optimum_mean_vertex_error_mm", 1.0) < WITHIN_REACH_MM:
            row["optimum_ratio"] = EXACT
        yield row


def write_table(out: Path, rows: Sequence[Mapping[str, Any]], entries: Sequence[Entry]) -> None:
    """Write the table as CSV, and as Markdown with what each rig is and its licence."""
    write_text(out / f"{NAME}.csv", csv_text(list(dict.fromkeys(key for row in rows for key in row)), rows))
    columns = {"rig": "rig", "set": "set", **FACTS, **FIGURES, "frames_per_s": "frames/s"}
    cells, before = [], None
    for row in rows:
        once = row["rig"] != before  # what holds for a rig stands in its first row alone
        keys = [key for key in columns if once or key not in {"rig", "frames_per_s", *FACTS}]
        cells.append([_cell(row.get(key)) if key in keys else "" for key in columns])
        before = row["rig"]
    table = markdown_text(list(columns.values()), cells, (0, 1))
    rigs = markdown_text(
        ["rig", "what it is", "licence"], [[each.name, each.about, each.licence] for each in entries], (0, 1, 2)
    )
    write_text(out / f"{NAME}.md", f"{table}\n{rigs}")


def _cell(value: Any) -> str:
    return (
        f"{value:,}" if isinstance(value, int) else f"{value:,.0f}" if isinstance(value, float) and value > 99 else shown(value)
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all rigs of all folders; the table is written anew after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders with a rigs.yaml")
    parser.add_argument("--out", type=Path, default=Path("runs") / NAME)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--only", nargs="+", default=[], help="names of rigs; the others are left out")
    parser.add_argument("--set", nargs="+", default=[], help="further settings of riginv.train, for all rigs")
    given = parser.parse_args(arguments)
    out = given.out.resolve()
    entries = [entry for folder in given.folders for entry in read_list(folder) if entry.name in (given.only or [entry.name])]
    extra, rows, done = [f"trainer.max_steps={given.steps}", "pictures.final=false", *given.set], [], []
    for entry in entries:
        found = [run for seed in given.seeds if (run := run_entry(entry, out, seed, extra)) is not None]
        if found:
            rows += rows_of(entry, facts_of(load(found[0][0], entry.folder)), [metrics for _, metrics in found])
            done.append(entry)
        write_table(out, rows, done)
    print((out / f"{NAME}.md").read_text())


if __name__ == "__main__":
    main()
