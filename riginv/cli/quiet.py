"""Messages of libraries that say nothing to a user of riginv."""

import logging
import warnings

# Each is known and meant; what it would tell is in the comment.
WARNINGS = (
    ".*isinstance\\(treespec, LeafSpec\\).*",  # lightning with torch 2.13
    ".*IterableDataset.*__len__.*",  # batches are drawn by number, in one process
    ".*number of training batches.*smaller than the logging interval.*",  # short runs still log each validation
    ".*does not have many workers.*",  # drawing a batch is cheaper than moving it between processes
    ".*Checkpoint directory.*exists and is not empty.*",  # checked by riginv.cli.run_folder
    ".*resuming from a checkpoint that ended before the epoch.*",  # riginv.data.poses goes on at the right batch
    ".*Experiment logs directory.*exists.*",
    ".*recommended to use `self.log.*sync_dist=True.*",  # what is logged is that of all processes already
    ".*`broadcast_buffers` is deprecated.*",  # its successor is not in every torch that riginv runs with
    ".*does not have a deterministic implementation.*",  # deterministic=warn: where there is one it is used
)


def hush() -> None:
    """Silence the messages above, and Lightning's account of the machine."""
    for message in WARNINGS:
        warnings.filterwarnings("ignore", message=message)
    for name in ("lightning", "lightning.pytorch", "lightning.fabric", "lightning.pytorch.utilities.rank_zero"):
        logging.getLogger(name).setLevel(logging.ERROR)
