"""Accuracy of predicted controls against the true ones, where these are known."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from riginv.rig.control_effects import ControlEffects

ACTIVE = 0.02  # fraction of a control's range: one that is farther from neutral is active
MAX_PAIRS, MIN_FRACTION = 10, 0.05  # of the confused pairs that are listed


class ConfusedPair(NamedTuple):
    """A control whose motion another control made.

    Attributes:
        control: the true control, which was found too near to neutral.
        instead: the control that was found too far from neutral.
        frames: number of frames in which both are off by more than `ACTIVE` and their errors cancel in the mesh.
        fraction: of the motion that `control` lacks, over all frames, what `instead` makes.
    """

    control: str
    instead: str
    frames: int
    fraction: float


@dataclass(frozen=True)
class ControlAccuracy:
    """Accuracy of predicted controls against the true ones. Controls that the mesh does not distinguish count as one.

    Attributes:
        precision: of the active controls that were found, the fraction that is truly active; NaN: none was found.
        recall: of the truly active controls, the fraction that was found active; NaN: none is.
        error: mean absolute error in fractions of the range.
        weighted_error: the same, weighted by how far each control moves the mesh over its range (root mean square).
        correlation: of a control's curve with the true one, averaged over controls whose true curve varies; NaN: no clip.
        active, true_active: number of active controls a frame.
        confused: pairs of controls, those that move the mesh most first.
        merged: names of controls that count as one.
        without_effect: names of controls that move no vertex; they do not count.
    """

    precision: float
    recall: float
    error: float
    weighted_error: float
    correlation: float
    active: float
    true_active: float
    confused: tuple[ConfusedPair, ...]
    merged: tuple[tuple[str, ...], ...]
    without_effect: tuple[str, ...]

    def figures(self) -> dict[str, float]:
        """The numbers by the names they have in metrics.json; those that are not defined are left out."""
        values = {
            "control_precision": self.precision,
            "control_recall": self.recall,
            "control_error": self.error,
            "control_error_weighted": self.weighted_error,
            "control_correlation": self.correlation,
            "active_controls": self.active,
            "true_active_controls": self.true_active,
        }
        return {key: value for key, value in values.items() if not math.isnan(value)}

    def as_json(self) -> dict[str, Any]:
        """The numbers, the confused pairs and the controls that count as one or not at all."""
        return {
            **self.figures(),
            "confused_controls": [pair._asdict() for pair in self.confused],
            "controls_counted_as_one": [list(group) for group in self.merged],
            "controls_without_effect": list(self.without_effect),
        }


def control_accuracy(effects: ControlEffects, found: Tensor, true: Tensor, is_clip: bool) -> ControlAccuracy:
    """Compare controls with the true ones, both `(frame, control)`.

    Args:
        effects: of the rig's controls.
        is_clip: whether the frames follow each other, so that curves can be correlated.
    """
    found, true = effects.columns_of(found), effects.columns_of(true)
    active, truly = found.abs() > ACTIVE, true.abs() > ACTIVE
    right, off = float((active & truly).sum()), (found - true).abs()
    weights = effects.sizes_mm
    return ControlAccuracy(
        precision=_fraction(right, active),
        recall=_fraction(right, truly),
        error=float(off.mean()),
        weighted_error=float((off * weights).sum() / (weights.sum() * len(off))),
        correlation=_correlation(found, true) if is_clip else math.nan,
        active=float(active.sum(dim=1).double().mean()),
        true_active=float(truly.sum(dim=1).double().mean()),
        confused=confused_pairs(effects, found, true),
        merged=effects.merged,
        without_effect=effects.without_effect,
    )


def confused_pairs(effects: ControlEffects, found: Tensor, true: Tensor) -> tuple[ConfusedPair, ...]:
    """The pairs of columns `(frame, column)` of which one makes the motion of the other.

    The errors of such a pair cancel in the mesh: -d_i d_j G_ij > 0, with the Gram matrix G of their displacements. Summed over
    frames, this ranks the pairs.
    """
    change, nearer = found - true, found.abs() < true.abs()
    lacking, extra = torch.where(nearer, change, 0.0), torch.where(nearer, 0.0, change)
    cancelled = _cancelled(lacking, extra, effects.gram) * effects.gram.abs()
    far_lacking, far_extra = (_signs(each) for each in (lacking, extra))
    frames = _cancelled(far_lacking, far_extra, effects.gram)
    lost = (lacking.square().sum(dim=0) * effects.gram.diagonal()).clamp_min(1e-12)
    fractions = cancelled / lost[:, None]
    cancelled = torch.where((fractions >= MIN_FRACTION) & (frames > 0), cancelled, 0.0)
    cancelled.fill_diagonal_(0.0)
    pairs = []
    for index in cancelled.flatten().argsort(descending=True, stable=True)[:MAX_PAIRS].tolist():
        row, column = divmod(index, len(cancelled))
        if cancelled[row, column] > 0:
            names = effects.names[row], effects.names[column]
            pairs.append(ConfusedPair(*names, int(frames[row, column]), min(float(fractions[row, column]), 1.0)))
    return tuple(pairs)


def _cancelled(lacking: Tensor, extra: Tensor, gram: Tensor) -> Tensor:
    """The sum over frames of |d_i d_j| `(column, column)`, where the displacements of d_i and d_j oppose each other."""
    up, down, more, less = lacking.clamp_min(0), (-lacking).clamp_min(0), extra.clamp_min(0), (-extra).clamp_min(0)
    return torch.where(gram > 0, up.T @ less + down.T @ more, up.T @ more + down.T @ less)


def _signs(change: Tensor) -> Tensor:
    return torch.where(change.abs() > ACTIVE, change.sign(), 0.0)


def _fraction(right: float, of: Tensor) -> float:
    return right / float(of.sum()) if bool(of.any()) else math.nan


def _correlation(found: Tensor, true: Tensor) -> float:
    varies = true.amax(dim=0) - true.amin(dim=0) > ACTIVE
    found, true = (each[:, varies] - each[:, varies].mean(dim=0) for each in (found, true))
    size = (found.square().sum(dim=0) * true.square().sum(dim=0)).sqrt()
    return float(((found * true).sum(dim=0) / size.clamp_min(1e-12)).mean())
