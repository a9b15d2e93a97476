"""Networks of operations: gather, net, weighted sum, scatter."""

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format.later_layers import MachineLearning, MachineLearningOperations, Operation
from rigs.dna.logic.layout import Layout, Stage, put
from rigs.dna.logic.nets import NetStage, check_outputs

GATHER, SCATTER, NET, SUM = 1, 2, 3, 4
Key = tuple[int, int, int]  # of an operation: type, set, number


class OperationStage(Stage):
    """An operation.

    Attributes:
        sources: keys of the operations that it depends on.
        size: number of its results.
    """

    controls: Tensor
    weights: Tensor
    net: NetStage

    def __init__(self, kind: int, sources: list[Key]) -> None:
        super().__init__()
        self.kind, self.sources, self.size = kind, sources, 0


class Operations(Stage):
    """All operations of a level of detail.

    Raises:
        InputError: an operation is damaged or not supported: nets cut by level of detail.
    """

    def __init__(
        self, layout: Layout, learned: MachineLearning | None, operations: MachineLearningOperations, lod: int
    ) -> None:
        super().__init__()
        self.layout, self.learned = layout, learned
        self.keys: list[Key] = []
        steps: list[OperationStage] = []
        sizes: dict[Key, int] = {}
        for number, kind in enumerate(operations.types):
            if len(kind.lods) < len(kind.sets):
                raise layout.wrong(f"{len(kind.sets)} sets of operations have {len(kind.lods)} tables of levels of detail")
            for position, operation_set in enumerate(kind.sets):
                what = f"set {position} of operations"
                chosen = layout.rows_of_lod(what, kind.lods[position], lod, len(operation_set), "operations")
                for step in chosen.tolist():
                    key = (number, position, step)
                    stage = self._stage(f"operation {step} of {what}", operation_set[step], number, sizes)
                    sizes[key] = stage.size
                    steps.append(stage)
                    self.keys.append(key)
        self.steps = torch.nn.ModuleList(steps)
        del self.layout, self.learned

    def _stage(self, what: str, step: Operation, number: int, sizes: dict[Key, int]) -> OperationStage:
        layout, parameters = self.layout, step.parameters
        layout.check_lengths(what, sets=len(step.sets), operations=len(step.operations))
        sources = [(number, int(one), int(other)) for one, other in zip(step.sets, step.operations)]
        missing = [source for source in sources if source not in sizes]
        if missing:
            raise layout.wrong(f"{what} depends on operation {missing[0][2]} of set {missing[0][1]}, which is not before it")
        inputs = [sizes[source] for source in sources]
        stage = OperationStage(step.kind, sources)
        if step.kind == GATHER:
            layout.check_controls(what, parameters)
            stage.keep(controls=parameters.astype(int))
            stage.size = len(parameters)
        elif step.kind == SCATTER:
            check_outputs(layout, what, parameters)
            if sum(inputs) != len(parameters):
                raise layout.wrong(f"{what} writes {len(parameters)} controls with {sum(inputs)} numbers")
            stage.keep(controls=parameters.astype(int))
        elif step.kind == NET:
            self._add_net(stage, what, step, sum(inputs))
        elif step.kind == SUM:
            if len(parameters) != 1 + len(sources) or any(size != int(parameters[0]) for size in inputs):
                raise layout.wrong(f"{what} sums {inputs} numbers with {len(parameters)} parameters")
            weights = parameters[1:].astype(np.uint32).view(np.float32)
            layout.check_finite(what, weights)
            stage.keep(weights=weights.astype(np.float64))
            stage.size = int(parameters[0])
        else:
            raise layout.wrong(f"{what} is of kind {step.kind}, expected 1 to 4")
        return stage

    def _add_net(self, stage: OperationStage, what: str, step: Operation, inputs: int) -> None:
        layout, nets = self.layout, self.learned.nets if self.learned else ()
        if not len(step.parameters):
            raise layout.wrong(f"{what} names no net")
        layout.check(what, step.parameters[:1], len(nets), "nets")
        if len(step.parameters) > 1:
            raise layout.wrong(f"{what} cuts a net by level of detail, which cannot be evaluated here")
        number = int(step.parameters[0])
        stage.net = NetStage(layout, f"net {number}", nets[number], inputs, None)
        stage.size = stage.net.size

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)`, with the scattered results."""
        results: dict[Key, Tensor] = {}
        for key, step in zip(self.keys, self.steps):
            assert isinstance(step, OperationStage)
            given = [results[source] for source in step.sources]
            if step.kind == GATHER:
                results[key] = controls.index_select(1, step.controls)
            elif step.kind == SCATTER:
                controls = put(controls, step.controls, torch.cat(given, dim=1))
                results[key] = controls[:, :0]
            elif step.kind == NET:
                results[key] = step.net(torch.cat(given, dim=1))
            else:
                weights = step.weights.to(controls)
                results[key] = torch.einsum("s,sbn->bn", weights, torch.stack(given))
        return controls
