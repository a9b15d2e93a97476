"""The claims of the paper, tested with the figures of a run."""

import statistics
from collections.abc import Callable
from typing import Any

from riginv.reproduce.sets import CAPTURED, CLIP, COMBINATIONS, POSES
from riginv.reproduce.tables import SMOOTHER, Results
from riginv.reproduce.wording import MEAN

HELD, NOT_HELD, DEPENDS, UNTESTED = "held", "not held", "depends", "not tested"
SAME_SEEDS = 0.05  # a relative spread over seeds below this counts as consistent
MOSTLY = 0.5
Verdict = tuple[str, str]


def claims(results: Results) -> list[dict[str, Any]]:
    """Each claim of the paper with its verdict and figures."""
    return [
        {"claim": text, "section": section, "verdict": verdict, "figures": figures}
        for text, section, test in CLAIMS
        for verdict, figures in [test(results)]
    ]


def _better(results: Results, ours: str, theirs: str, sets: tuple[str, ...]) -> Verdict:
    """Whether the errors of a row are below those of another, over common seeds, on all sets, some, or none."""
    pairs: dict[str, tuple[float, float]] = {}
    for name in sets if {ours, theirs} <= results.plan.rows.keys() else ():
        both = list(zip(results.errors(ours, name), results.errors(theirs, name)))
        if both:
            pairs[name] = statistics.fmean(a for a, _ in both), statistics.fmean(b for _, b in both)
    shown = ", ".join(f"{_set_name(results, name)} {a:.3g} against {b:.3g} mm" for name, (a, b) in pairs.items())
    return _all_or_none([a < b for a, b in pairs.values()]), shown


def _mesh_loss(results: Results) -> Verdict:
    verdict, shown = _better(results, "inverse", "holden", (COMBINATIONS, CAPTURED))
    alike, same_data = _better(results, "on_holdens_poses", "holden", (COMBINATIONS, CAPTURED, POSES))
    if alike == UNTESTED:
        return verdict, shown
    together = verdict if verdict == alike else DEPENDS
    return together, f"{shown}; with the mesh loss on the poses that Holden's network is trained on: {same_data}"


def _normalisation(results: Results) -> Verdict:
    kinds = {"batch_normalised": "batch", "layer_normalised": "layer"}
    tests = {kind: _better(results, "inverse", row, (COMBINATIONS, CAPTURED)) for row, kind in kinds.items()}
    shown = "; ".join(f"none against {kind} normalisation: {figures}" for kind, (_, figures) in tests.items() if figures)
    return _together([verdict for verdict, _ in tests.values()]), shown


def _ranges(results: Results) -> Verdict:
    bounded, free = results.rig_errors(True, MEAN), results.one("evaluate-unbounded_surrogate", MEAN)
    inverse, figures = _better(results, "trained", "unbounded", (COMBINATIONS, CAPTURED))
    if free is None:
        return inverse, figures
    sigmoid = HELD if bounded[0] < free else NOT_HELD
    shown = f"trained rig with sigmoids {bounded[0]:.3g}, without {free:.3g} mm; inverse with tanh against without: {figures}"
    return _together([sigmoid, inverse]), shown


def _seeds(results: Results) -> Verdict:
    rows = ("inverse", "trained", "holden", "best")
    spreads = {
        f"{results.plan.rows[row].label} on {_set_name(results, name)}": statistics.stdev(values) / statistics.fmean(values)
        for row in rows
        for name in (COMBINATIONS, CAPTURED)
        if len(values := results.errors(row, name)) > 1
    }
    surrogates = results.rig_errors(True, MEAN)
    if len(surrogates) > 1:
        spreads["trained rig"] = statistics.stdev(surrogates) / statistics.fmean(surrogates)
    if not spreads:
        return UNTESTED, "one seed alone"
    worst = max(spreads, key=lambda name: spreads[name])
    count = sum(spread < SAME_SEEDS for spread in spreads.values())
    verdict = HELD if count == len(spreads) else DEPENDS if count > len(spreads) / 2 else NOT_HELD
    shown = f"{count} of {len(spreads)} spreads over {len(results.plan.seeds)} seeds are below {SAME_SEEDS:.0%} of the mean"
    return verdict, f"{shown}; the widest: {worst}, {spreads[worst]:.1%}"


def _smoothness(results: Results) -> Verdict:
    ratios = {rig: ratio for rig, rows in SMOOTHER.items() if (ratio := results.smoothness_ratio(*rows)) is not None}
    shown = ", ".join(f"{ratio:.3g} times with the {rig} rig" for rig, ratio in ratios.items())
    return _all_or_none([ratio >= 10 for ratio in ratios.values()]), shown


def _sparsity(results: Results) -> Verdict:
    known = {
        row: results.of_inversion(row, f"{CLIP}/nonzero_controls") for row in ("inverse", "tanh") if row in results.plan.rows
    }
    used = {row: values[0] for row, values in known.items() if values}
    if len(used) < 2:
        return UNTESTED, ""
    shown = f"leaky ReLU {used['inverse']:.1f}, tanh {used['tanh']:.1f}"
    verdict = HELD if used["inverse"] < used["tanh"] else NOT_HELD
    return verdict, f"nonzero controls in a frame of the {_set_name(results, CLIP)}: {shown}"


def _noise(results: Results) -> Verdict:
    plain, noisy = (results.one(f"lipschitz-{name}", "ranges_per_mm") for name in ("inverse", "noisy"))
    if plain is None or noisy is None:
        return UNTESTED, ""
    shown = f"local Lipschitz constant {plain:.3g} without, {noisy:.3g} with noise, controls' ranges per mm"
    rough = [results.of_inversion(row, "roughness") for row in ("inverse", "noisy")]
    if all(rough):
        shown += f"; roughness {rough[0][0]:.2g} and {rough[1][0]:.2g}"
    return HELD if noisy < plain else NOT_HELD, shown


def _reach(results: Results) -> Verdict:
    least = results.mean("optimum", CAPTURED)
    errors = {row: error for row in ("inverse", "best") if (error := results.mean(row, CAPTURED)) is not None}
    if least is None or len(errors) < 2:
        return UNTESTED, ""
    shares = {row: least / error for row, error in errors.items()}
    shown = ", ".join(f"{shares[row]:.0%} of that of {results.plan.rows[row].label}" for row in errors)
    text = f"the optimum's error on the {_set_name(results, CAPTURED)}, {least:.3g} mm, is {shown}"
    return _all_or_none([share > MOSTLY for share in shares.values()]), text


def _set_name(results: Results, name: str) -> str:
    return (results.clip_name if name in (CLIP, CAPTURED) else name).replace("_", " ")


def _all_or_none(tests: list[bool]) -> str:
    return UNTESTED if not tests else HELD if all(tests) else DEPENDS if any(tests) else NOT_HELD


def _together(verdicts: list[str]) -> str:
    tested = {verdict for verdict in verdicts if verdict != UNTESTED}
    return tested.pop() if len(tested) == 1 else DEPENDS if tested else UNTESTED


CLAIMS: list[tuple[str, str, Callable[[Results], Verdict]]] = [
    ("A loss on the mesh beats a loss on the controls, since rigs are not injective", "3.1.2, Table 2", _mesh_loss),
    ("Networks without normalisation are better", "4.1, 4.2", _normalisation),
    ("Outputs should be kept in range: sigmoids for weights, tanh for controls", "4.1, 4.2", _ranges),
    ("Results are consistent across random initialisations", "4.1, 4.2", _seeds),
    (
        "The inverse is an order of magnitude smoother than direct optimisation, without noise augmentation",
        "4.3, Table 3",
        _smoothness,
    ),
    ("Leaky ReLU makes for sparse controls", "3.3", _sparsity),
    ("Noise augmentation lowers the local Lipschitz constant of the inverse", "3.3", _noise),
    ("The error on captured data is mostly what the rig cannot express", "4.2", _reach),
]
