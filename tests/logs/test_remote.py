"""Files at a store that is in memory: what is there, and what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from logs.errors import ConfigError
from logs.files import heads, listed

fsspec = pytest.importorskip("fsspec", reason="the extra s3 is not installed: pip install 'replan[s3]'")


@pytest.fixture
def store() -> Iterator[Any]:
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()


def test_a_begin_that_cannot_be_read_is_one_line_that_names_it(store: Any) -> None:
    store.pipe({"/fleet/a.mcap": b"abc", "/fleet/b.mcap": b"defg"})
    files = listed("memory://fleet")
    assert heads(files, 2) == [b"ab", b"de"]
    store.rm("/fleet/b.mcap")
    with pytest.raises(ConfigError, match=r"^memory://fleet/b.mcap: not there"):
        heads(files, 2)


def test_a_name_that_leads_out_of_its_folder_is_refused(store: Any) -> None:
    store.pipe("/fleet/a/../../evil.mcap", b"abc")
    with pytest.raises(ConfigError, match=r"a/../../evil.mcap: has '..' in its name"):
        listed("memory://fleet")
