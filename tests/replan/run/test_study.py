"""The file of a study: what is taken, what is refused, and that nothing foreign is touched."""

from pathlib import Path

import pytest

from replan.core.errors import ConfigError
from replan.experiments.tune import CONTENTS
from replan.run.claim import STUDY as FILE, claimed_folder
from replan.run.resume import Study

HEAD = {"study": "tune", "seed": 0}


def test_trials_are_known_again_and_another_head_is_refused(tmp_path: Path) -> None:
    study = Study(tmp_path, HEAD, resume=False)
    study.add([{"key": "a", "value": 1.5}, {"key": "b", "value": None}])
    before = (tmp_path / FILE).read_bytes()
    again = Study(tmp_path, HEAD, resume=True)
    assert (
        again.resumed == 2
        and again.known("a") == {"key": "a", "value": 1.5}
        and again.known("c") is None
    )
    assert (tmp_path / FILE).read_bytes() == before
    with pytest.raises(ConfigError, match="was started with other settings: seed was 0, is 1"):
        Study(tmp_path, {**HEAD, "seed": 1}, resume=True)
    assert (tmp_path / FILE).read_bytes() == before
    assert Study(tmp_path, {**HEAD, "seed": 1}, resume=False).resumed == 0


@pytest.mark.parametrize(
    ("name", "text", "resume", "said"),
    [
        ("diary.txt", "", False, "contains diary.txt, not results of `replan tune`"),
        (FILE, '{"study": "falsify"}\n', False, "not results of `replan tune`"),
        (FILE, "no json", False, "not results of `replan tune`"),
        (FILE, '{"study": "tune"}\n{"value": 1}\n', True, "contains no study"),
        (FILE, '{"study": "tune"}\n[[[\n', True, "cannot be read as a study"),
        (
            FILE,
            '{"study": "tune"}\n{"key": "a", "value": 1.5, "crc32": 7}\n',
            True,
            "line 2 is not as replan wrote it",
        ),
        (None, "", True, "contains no study to resume"),
    ],
)
def test_a_folder_without_study_is_left_as_it_is(
    tmp_path: Path, name: str | None, text: str, resume: bool, said: str
) -> None:
    if name is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with (
        pytest.raises(ConfigError, match=said),
        claimed_folder(tmp_path, CONTENTS, resume=resume) as out,
    ):
        Study(out, HEAD, resume=resume)
    assert name is None or (tmp_path / name).read_text(encoding="utf-8") == text


def test_a_file_of_a_user_beside_a_study_is_not_removed(tmp_path: Path) -> None:
    Study(tmp_path, HEAD, resume=False)
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    with (
        pytest.raises(ConfigError, match=r"contains notes\.txt"),
        claimed_folder(tmp_path, CONTENTS),
    ):
        pass
    assert (tmp_path / "notes.txt").is_file()


def test_a_line_that_is_cut_is_left_out_at_any_byte(tmp_path: Path) -> None:
    study = Study(tmp_path, HEAD, resume=False)
    study.add([{"key": name, "value": "ä"} for name in "abc"])
    whole = (tmp_path / FILE).read_bytes()
    head = len(whole.split(b"\n")[0]) + 1
    for end in range(head, len(whole) + 1):
        (tmp_path / FILE).write_bytes(whole[:end])
        again = Study(tmp_path, HEAD, resume=True)
        assert again.resumed == whole[head:end].count(b"\n")
        again.add({"key": name, "value": "ä"} for name in "abc" if again.known(name) is None)
        assert (tmp_path / FILE).read_bytes() == whole
