"""The file of a study: what is taken, what is refused, and that nothing foreign is touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from logs import ConfigError
from replay.search.study import FILE, Study

HEAD = {"study": "tune", "seed": 0}


def test_trials_are_known_again_and_another_head_is_refused(tmp_path: Path) -> None:
    study = Study(tmp_path, HEAD, resume=False)
    study.add([{"key": "a", "value": 1.5}, {"key": "b", "value": None}])
    before = (tmp_path / FILE).read_bytes()
    again = Study(tmp_path, HEAD, resume=True)
    assert again.resumed == 2 and again.known("a") == {"key": "a", "value": 1.5} and again.known("c") is None
    assert (tmp_path / FILE).read_bytes() == before
    with pytest.raises(ConfigError, match="was started with other settings: seed was 0, is 1"):
        Study(tmp_path, {**HEAD, "seed": 1}, resume=True)
    assert (tmp_path / FILE).read_bytes() == before
    assert Study(tmp_path, {**HEAD, "seed": 1}, resume=False).resumed == 0


@pytest.mark.parametrize(
    ("name", "text", "resume", "said"),
    [
        ("diary.txt", "", False, "contains no study of `replan tune`"),
        (FILE, '{"study": "falsify"}\n', False, "contains no study of `replan tune`"),
        (FILE, "no json", False, "cannot be read as a study"),
        (FILE, '{"study": "tune"}\n{"value": 1}\n', True, "contains no study"),
        (None, "", True, "contains no study to resume"),
    ],
)
def test_what_is_no_study_is_not_touched(tmp_path: Path, name: str | None, text: str, resume: bool, said: str) -> None:
    if name is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        Study(tmp_path, HEAD, resume=resume)
    assert name is None or (tmp_path / name).read_text(encoding="utf-8") == text
