"""Kernels are compiled once, before the tests are spread over processes that would each compile them."""

import gc
import zlib

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--one-in", type=int, default=1, metavar="N", help="run the first case of each test, and one in N")


def pytest_configure(config: pytest.Config) -> None:
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        # time stepping is imported when it is first used, and registers its kernels then
        import pincontact.integration.moreau  # noqa: F401
        from pincontact.jit import compile_kernels

        compile_kernels(several=True, stepping=True, called=True)


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
