"""A process that ends with the one that started it, even where that is killed."""

import os
import threading
import time

EVERY_SECONDS = 0.5


def end_with(parent: int) -> None:
    """End this process as soon as its parent, of that process number, is gone."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(EVERY_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
