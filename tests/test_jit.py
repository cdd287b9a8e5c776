"""Machine code on disk."""

from __future__ import annotations

import os

import numba
import pytest
from numba import types

from pincontact import jit
from pincontact.callback import separate_kernel
from pincontact.jit import CALLED, INTEGER, REAL, SEPARATE, Entry, entry_kernel, kernel


@separate_kernel(REAL, REAL, INTEGER, when=CALLED)
def power(x, n):
    result = 1.0
    for _ in range(n):
        result *= x
    return result


@kernel
def powers(x):
    return 10.0 * power(x, 2) + power(x, 3)


@entry_kernel(REAL, when=CALLED)
def sum_of_powers(x):
    return 1.0 + powers(x)


@separate_kernel(INTEGER, REAL, when=CALLED)
def meaningless_part(x):
    return x.nothing


@entry_kernel(REAL, when=CALLED)
def with_meaningless_part(x):
    return 1 if x < 0.0 else meaningless_part(x)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="machine code")
def test_a_separate_kernel_is_fetched_where_it_is_called():
    """Also from Python it is called by its name."""
    entry = SEPARATE[power]
    assert not entry.compiled.overloads
    assert [sum_of_powers(x) for x in (0.0, 2.0, 3.0)] == [1.0, 49.0, 118.0]
    assert entry.compiled.overloads
    assert power(2.0, 5) == 32.0


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="machine code")
def test_a_separate_kernel_that_cannot_be_fetched_is_an_error():
    assert with_meaningless_part(-1.0) == 1
    with pytest.raises((numba.TypingError, SystemError)):
        with_meaningless_part(2.0)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="machine code")
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("keep", [0, 40, 400])
def test_kernels_on_disk_that_cannot_be_read_are_compiled_again(suffix, keep, tmp_path, monkeypatch, caplog):
    """Index or machine code cut short, as a crash or a full disk leaves them: the next process repairs that, and says
    so."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def seven_times(x):
        return 7 * x

    def called():
        compiled = numba.njit(cache=True)(seven_times)
        Entry(compiled, (types.int64,), tmp_path, CALLED).compile()
        assert compiled(3) == 21
        return sum(compiled.stats.cache_hits.values())

    assert [called(), called()] == [0, 1]
    assert not caplog.messages
    (file,) = tmp_path.rglob(f"*.{suffix}")
    file.write_bytes(file.read_bytes()[:keep])
    assert [called(), called()] == [0, 1]
    assert [record.levelname for record in caplog.records if "cannot be read" in record.message] == ["WARNING"]


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="machine code")
def test_kernels_that_cannot_be_compiled_say_why(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def meaningless(x):
        return x.nothing

    with pytest.raises(numba.TypingError, match="nothing"):
        Entry(numba.njit(cache=True)(meaningless), (types.int64,), tmp_path, CALLED).compile()


def test_the_key_of_a_file_elsewhere_follows_the_package(tmp_path, monkeypatch):
    """By whatever name it calls kernels of the package."""
    package, own = tmp_path / "package", tmp_path / "own.py"
    (package / "inner").mkdir(parents=True)
    (package / "inner" / "kernels.py").write_text("a = 1\n")
    own.write_text("from pincontact.inner.kernels import a\n")
    monkeypatch.setattr(jit, "_PACKAGE", package)

    def key():
        for cached in (jit.source_hash, jit._read, jit._names_in):
            cached.cache_clear()
        return jit.source_hash(str(own))

    before = key()
    assert key() == before
    (package / "inner" / "kernels.py").write_text("a = 2\n")
    assert key() != before


def test_the_key_follows_all_that_a_file_imports(tmp_path, monkeypatch):
    """By modules and by names, over several files and around a circle; not what it does not import."""
    monkeypatch.setattr(jit, "_PACKAGE", tmp_path)
    texts = {
        "one/first.py": "from ..two import middle\n",
        "two/__init__.py": "",
        "two/middle.py": "from .last import (\n    a,\n    b,\n)\n",
        "two/last.py": "from ..one.first import c\n",
        "two/other.py": "from .last import a\n",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)

    def keys():
        # as in a new process
        for cached in (jit.source_hash, jit._read, jit._names_in):
            cached.cache_clear()
        return [jit.source_hash(str(tmp_path / name)) for name in ("one/first.py", "two/other.py")]

    before = keys()
    assert keys() == before
    for name, follows in (
        ("two/last.py", [True, True]),
        ("two/middle.py", [True, True]),
        ("two/other.py", [False, True]),
    ):
        (tmp_path / name).write_text(texts[name] + "# edited\n")
        after = keys()
        assert [new != old for new, old in zip(after, before)] == follows, name
        before = after
    # one that is installed again as it was
    os.utime(tmp_path / "one/first.py", ns=(1, 1))
    assert [new != old for new, old in zip(keys(), before)] == [numba.version_info.short < (0, 68), False]
