"""What is done once for all processes that tests are spread over: kernels are compiled, and files of tests read."""

import contextlib
import gc
import importlib
import os
import sys
import zlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--one-in", type=int, default=1, metavar="N", help="run the first case of each test, and one in N")


def pytest_configure(config: pytest.Config) -> None:
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        # time stepping is imported when it is first used, and registers its kernels then
        import pincontact.integration.moreau  # noqa: F401
        from pincontact.jit import compile_kernels

        compile_kernels(several=True, stepping=True, called=True)


def pytest_collection(session: pytest.Session) -> None:
    """Reading the files takes pytest ten seconds, unless it finds what an earlier process has made of them: every other
    process begins with the last file, so that two of them meet halfway."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return
    # also where Python is told to keep nothing: each process would do all of it
    sys.dont_write_bytecode = False
    if int(worker["workerid"].removeprefix("gw")) % 2 and list(map(os.path.abspath, session.config.args)) == [
        str(FOLDER)
    ]:
        for file in sorted(FOLDER.rglob("test_*.py"), reverse=True):
            # what is wrong with a file is told when its turn comes
            with contextlib.suppress(Exception, pytest.skip.Exception):
                importlib.import_module(file.stem)


def pytest_collection_finish() -> None:
    """What has been imported and collected stays: looking for garbage in it takes half a second each time."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Drop the cases that are not asked for: the same ones in every process, of all parameters."""
    one_in = config.getoption("--one-in")
    seen: set[str] = set()
    dropped = []
    for item in items:
        test = item.nodeid.split("[")[0]
        if test in seen and zlib.crc32(item.nodeid.encode()) % one_in:
            dropped.append(item)
        seen.add(test)
    if dropped:
        items[:] = [item for item in items if item not in set(dropped)]
        config.hook.pytest_deselected(items=dropped)
