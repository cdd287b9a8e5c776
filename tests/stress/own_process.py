"""Work in a process of its own, with a limit on its time, so that nothing can hang."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from typing import Any


def in_own_process(
    target: Callable[..., None], arguments: tuple[Any, ...], left: Callable[[int], float], late: str
) -> tuple[list[Any], str]:
    """What target(*arguments, connection) sends, and what ended it before its time: `late`, or an exception it sent.

    It sends None when it is done. left(n): s that it may take for the next one after n.
    """
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    process = context.Process(target=target, args=(*arguments, writer), daemon=True)
    process.start()
    writer.close()
    found: list[Any] = []
    trouble = ""
    while True:
        try:
            if not reader.poll(left(len(found))):
                trouble = late
                process.terminate()
                break
            received = reader.recv()
        except EOFError:
            trouble = "its process died"
            break
        if received is None:
            break
        if isinstance(received, Exception):
            trouble = f"raised {received!r}"
            break
        found.append(received)
    process.join()
    return found, trouble
