"""The default prior: generated performances in which controls are co-activated, from a rig's expressions and names.

Sources, as far as a rig has them: its named expressions, controls with ARKit's names (`riginv.tracking.priors.coactivation`),
and controls that differ in their side alone. Independent draws of controls would contain no correlations.
"""

import re

import numpy as np
import torch

from riginv.rig.interface import RigBackend
from riginv.sampling.correlated import other_sides
from riginv.tracking.priors.coactivation import ACTIONS
from riginv.tracking.priors.prior import RIDGE, ControlPrior, learn_prior

DRAWS = 20_000
SEED = 20221206
TOGETHER = 3.0  # actions that are active at a time, on average
ALONE = 2.5  # controls that move on their own besides, on average
ONE_SIDED = 0.25  # of the actions
UNEVENNESS = 0.12  # relative standard deviation of a control's weight in an action
BASELINE = 0.03  # mean of the weak activation that every control always has
WHOLE, PART = 0.85, 0.35  # the greatest strength of an action of several controls, and of a control on its own
STRONG = 0.85  # of the way to a limit, of the poses to start from


def default_prior(rig: RigBackend, draws: int = DRAWS) -> ControlPrior:
    """The prior of a rig for which there is no take."""
    rng = np.random.default_rng(SEED)
    actions, others = _actions(rig), np.asarray(other_sides(rig.control_names))
    count = len(rig.controls)
    own = np.eye(count)[others >= np.arange(count)]  # one for each control, or pair of controls
    strength = WHOLE * _strengths(rng, draws, len(actions), TOGETHER)
    poses = _played(rng, strength, actions, others)
    poses += _played(rng, PART * _strengths(rng, draws, len(own), ALONE), own + own[:, others] * (own == 0), others)
    neutral = ((rig.neutral_controls - rig.lower) / (rig.upper - rig.lower)).double().cpu().numpy()
    poses += BASELINE * rng.exponential(size=poses.shape)
    both = (neutral > 0) & (neutral < 1)
    sign = np.where(both & (rng.random(poses.shape) < 0.5) & (poses < 2 * PART), -1.0, 1.0)
    room = np.where(poses * sign >= 0, 1 - neutral, neutral)
    room = np.where(neutral >= 1, -1.0, room)
    units = np.clip(neutral + room * np.where(neutral >= 1, poses, poses * sign), 0, 1)
    lower, span = rig.lower.double().cpu(), (rig.upper - rig.lower).double().cpu()
    return learn_prior(rig, lower + span * torch.from_numpy(units), "simulated performances", RIDGE)


def _actions(rig: RigBackend) -> np.ndarray:
    """The controls of each action, `(action, control)`, as fractions from neutral (0) to the upper (1) or lower (-1) limit."""
    number = {name: index for index, name in enumerate(rig.control_names)}
    plain = {_plain(name): index for name, index in number.items()}
    found = []
    for members in ACTIONS.values():
        row = np.zeros(len(number))
        for name, weight in members.items():
            for full in (name, f"{name}Left", f"{name}Right"):
                if (index := plain.get(full.lower())) is not None:
                    row[index] = weight
        found.append(row)
    for members in rig.expressions().values():
        row = np.zeros(len(number))
        for name, value in members.items():
            control = rig.controls[number[name]]
            way = control.upper - control.neutral if value >= control.neutral else control.neutral - control.lower
            row[number[name]] = (value - control.neutral) / max(way, 1e-9)
        found.append(row)
    rows = [row for row in found if np.count_nonzero(row) > 1]
    return np.stack(rows) if rows else np.zeros((0, len(number)))


def _plain(name: str) -> str:
    """`blendShape1.mouthSmile_L` as `mouthsmileleft`."""
    stem = re.split(r"[.:]", name)[-1]
    side = re.fullmatch(r"(.+)[_\- ]([lLrR])", stem)
    stem = side[1] + {"l": "left", "r": "right"}[side[2].lower()] if side else stem
    return re.sub(r"[_\- ]", "", stem).lower()


def _strengths(rng: np.random.Generator, draws: int, actions: int, together: float) -> np.ndarray:
    """Random strengths of actions, `(draw, action)` in [0, 1]: mostly 0."""
    active = rng.random((draws, actions)) < together / max(actions, 1)
    return active * rng.beta(1.2, 1.2, (draws, actions))


def _played(rng: np.random.Generator, strength: np.ndarray, actions: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Poses `(draw, control)` of actions `(action, control)`, some of them on one side of the face alone."""
    draws, count = len(strength), actions.shape[1]
    lopsided = (others != np.arange(count)) & (others > np.arange(count))
    side = np.where(lopsided, 1, np.where(others < np.arange(count), -1, 0))
    poses = np.zeros((draws, count))
    for column, action in zip(strength.T, actions):
        rows = np.flatnonzero(column)
        uneven = 1 + UNEVENNESS * rng.normal(size=(len(rows), count))
        one = rng.random(len(rows)) < ONE_SIDED
        kept = np.where(one, rng.choice([-1, 1], len(rows)), 0)[:, None] * side[None] >= 0
        fade = np.where(kept, 1.0, rng.random((len(rows), 1)) * 0.5)
        poses[rows] += column[rows, None] * action * uneven * fade
    return poses


class PoseLibrary:
    """Poses to start from: each of a rig's actions, and each control on its own.

    Attributes:
        aims: target values of the controls that a pose moves, in fractions of their ranges, `(pose, control)`.
        moved: which these are, `(pose, control)`.
    """

    def __init__(self, aims: torch.Tensor, moved: torch.Tensor) -> None:
        self.aims, self.moved = aims, moved

    @classmethod
    def of(cls, rig: RigBackend) -> "PoseLibrary":
        neutral = ((rig.neutral_controls - rig.lower) / (rig.upper - rig.lower)).double().cpu()
        actions = torch.from_numpy(np.concatenate([_actions(rig), np.eye(len(neutral)), -np.eye(len(neutral))]))
        limit = torch.where((actions > 0) & (neutral < 1), 1.0, 0.0)
        aims = neutral + STRONG * actions.abs() * (limit - neutral)
        moved = (actions != 0) & (aims != neutral)
        kept = moved.any(dim=1)
        return cls(aims[kept].clamp(0, 1), moved[kept])

    def around(self, start: torch.Tensor) -> torch.Tensor:
        """The poses `(pose, control)` with all other controls as in `start` `(control,)`."""
        return torch.where(self.moved, self.aims, start)
