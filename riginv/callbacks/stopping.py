"""When training has nothing more to give."""

import lightning as L


class StopBelowLearningRate(L.Callback):
    """Stops once the schedule has brought the learning rate below a threshold (paper: 1e-6)."""

    def __init__(self, threshold: float) -> None:
        self.threshold = threshold

    def on_train_epoch_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if all(group["lr"] < self.threshold for optimizer in trainer.optimizers for group in optimizer.param_groups):
            trainer.should_stop = True
