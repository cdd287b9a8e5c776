"""Machine code on disk."""

from __future__ import annotations

import numba
import pytest
from numba import types

from pincontact.jit import CALLED, Entry


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
        Entry(compiled, (types.int64,), False, tmp_path, CALLED).compile()
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
        Entry(numba.njit(cache=True)(meaningless), (types.int64,), False, tmp_path, CALLED).compile()
