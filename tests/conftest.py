"""Kernels are compiled once, before the tests are spread over processes that would each compile them."""

import pytest


def pytest_configure(config: pytest.Config) -> None:
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        from pincontact.jit import compile_kernels

        compile_kernels(several=True, stepping=True)
