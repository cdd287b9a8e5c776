"""What the package tells its users beside results, errors and warnings: the logger `pincontact`.

So far that is when kernels are compiled, at level INFO. An application that sets up logging (a handler of the root
logger or of this one) gets these records there; without one they go to stderr, since a first run that is silent for
half a minute looks like one that hangs. `logging.getLogger("pincontact").setLevel("WARNING")` silences them.
"""

from __future__ import annotations

import logging
import sys


class _LastResort(logging.Handler):
    """As `logging.lastResort`, for the records of the package: writes to stderr where nobody else handles them."""

    def emit(self, record: logging.LogRecord) -> None:
        if [*log.handlers, *logging.getLogger().handlers] == [self]:
            sys.stderr.write(f"{self.format(record)}\n")
            sys.stderr.flush()


def _package_logger() -> logging.Logger:
    logger = logging.getLogger(__package__)
    handler = _LastResort()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logger.addHandler(handler)
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.INFO)
    return logger


log = _package_logger()
