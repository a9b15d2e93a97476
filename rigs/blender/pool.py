"""Pools of workers that evaluate poses (docs/worker-protocol.md)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from riginv.runs.worker_pool import ATTEMPTS, ProcessPool, Request
from riginv.runs.worker_process import Message, WorkerLostError

CHUNK = 16  # most poses of a request


class PoseLostError(RuntimeError):
    """A pose, or loading, lost several workers in a row; the message names the pose and the end of the last worker.

    Attributes:
        row: of the pose; None: no pose was requested.
    """

    def __init__(self, message: str, row: int | None = None) -> None:
        super().__init__(message)
        self.row = row


@dataclass(eq=False)
class PoseRequest(Request):
    """A request for the poses `rows`."""

    rows: range = range(0)

    @property
    def is_measured(self) -> bool:
        return bool(self.rows)

    def check(self, answer: Message) -> None:
        vertices = answer[1].get("vertices")
        if self.header["command"] == "evaluate" and (vertices is None or vertices.ndim != 3 or len(vertices) != len(self.rows)):
            shape = "no meshes" if vertices is None else vertices.shape
            raise WorkerLostError(f"it gave {shape} for {len(self.rows)} poses")

    def split(self) -> "Sequence[PoseRequest]":
        """Single poses, so that one bad pose affects no other."""
        if len(self.rows) <= 1:
            return [self]
        controls = self.arrays["controls"]
        return [
            PoseRequest(self.header, {"controls": controls[index : index + 1]}, rows=range(row, row + 1))
            for index, row in enumerate(self.rows)
        ]


class WorkerPool(ProcessPool):
    """Workers that all have loaded the same rig."""

    def describe(self, attempts: int = ATTEMPTS) -> Message:
        """A worker's description of what it has loaded.

        Args:
            attempts: workers that loading may lose.

        Raises:
            WorkerRefusedError: it cannot be loaded.
            PoseLostError: loading lost several workers.
        """
        (answer,) = self._run([PoseRequest({"command": "describe"})], attempts).values()
        return answer

    def evaluate(self, names: Sequence[str], controls: np.ndarray) -> np.ndarray:
        """The meshes of poses, in their order.

        Args:
            names: of the columns of `controls`; all other controls are neutral.
            controls: `(pose, control)` float32.

        Returns:
            `(pose, vertex, 3)` float32, mm.

        Raises:
            WorkerRefusedError: a pose cannot be evaluated.
            PoseLostError: a pose lost several workers in a row.
        """
        size = min(CHUNK, -(-len(controls) // self._settings[2]))
        header = {"command": "evaluate", "names": list(names)}
        starts = range(0, len(controls), max(size, 1)) or [0]
        rows = [range(start, min(start + size, len(controls))) for start in starts]
        answers = self._run([PoseRequest(header, {"controls": controls[part.start : part.stop]}, rows=part) for part in rows])
        return np.concatenate([answers[start][1]["vertices"] for start in sorted(answers)])

    def pose(self, names: Sequence[str], controls: np.ndarray) -> dict[str, np.ndarray]:
        """All arrays of the answer for one pose, `(control,)`; arguments and errors as `evaluate`."""
        request = PoseRequest({"command": "evaluate", "names": list(names)}, {"controls": controls[None]}, rows=range(1))
        return self._run([request])[0][1]

    def _run(self, requests: Sequence[PoseRequest], attempts: int = ATTEMPTS) -> dict[int, Message]:
        """The answers to requests, by the first row of each."""
        answers = {}
        with self.job(attempts) as job:
            job.submit(*requests)
            for request, outcome in job:
                assert isinstance(request, PoseRequest)
                if isinstance(outcome, WorkerLostError):
                    row = request.rows.start if request.rows else None
                    what = "opening the file" if row is None else f"pose {row}"
                    cost = f"cost {attempts} workers in a row; of the last one" if attempts > 1 else "ended the worker"
                    raise PoseLostError(f"{what} {cost}: {outcome}", row)
                if isinstance(outcome, BaseException):
                    raise outcome
                answers[request.rows.start] = outcome
        return answers
