"""CSV files as people and programs write them: read as meant, or refused in one line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.readers.csv_table import header_of, load_table

NAMES = ["t", "x", "y", "yaw", "v"]
ROWS = np.column_stack(
    [
        np.arange(6) * 0.1,
        np.arange(6) * 1.5,
        -np.arange(6) * 0.5,
        np.full(6, 0.01),
        np.full(6, 10.0),
    ]
)


def text(
    mark: str = ",",
    *,
    before: str = "",
    space: str = "",
    end: str = "",
    head_end: str = "",
    line: str = "\n",
    decimal: str = ".",
) -> str:
    """The table as text: lines before it, spaces around the mark, ends of the rows and of the
    header.
    """
    join = f"{space}{mark}{space}" if mark != " " else mark
    rows = [join.join(f"{value:.4f}".replace(".", decimal) for value in row) + end for row in ROWS]
    return line.join([before + join.join(NAMES) + head_end, *rows, ""])


@given(
    st.sampled_from([",", ";", "\t", " "]),
    st.sampled_from(["", "# ", "#", "\ufeff", "# made by a logger\n", "# a, b\n\n# unit: m\n#"]),
    st.sampled_from(["", " "]),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from([".", ","]),
)
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_however_a_table_is_written_it_is_the_same(
    tmp_path: Path,
    mark: str,
    before: str,
    space: str,
    ends: bool,
    head_ends: bool,
    line: str,
    decimal: str,
) -> None:
    decimal = "." if mark == "," else decimal
    file = tmp_path / "ego.csv"
    written = text(
        mark,
        before=before,
        space=space,
        end=mark * ends,
        head_end=mark * head_ends,
        line=line,
        decimal=decimal,
    )
    file.write_bytes(written.encode())
    table = load_table(file)
    assert list(table.columns[:5]) == NAMES == header_of(file)[:5]
    np.testing.assert_allclose(table[NAMES].to_numpy(float), ROWS, atol=1e-4)
    assert table.iloc[:, 5:].isna().all(axis=None)


def test_numpy_savetxt_and_texts_with_spaces_are_read(tmp_path: Path) -> None:
    file = tmp_path / "ego.csv"
    np.savetxt(file, ROWS, header=" ".join(NAMES))
    np.testing.assert_allclose(load_table(file)[NAMES].to_numpy(), ROWS)
    file.write_text('t, id , kind\n0.0, a ,car \n0.1,"b, c", van\n# lap 2\n0.2, #7,car\n')
    assert load_table(file).to_dict("list") == {
        "t": [0.0, 0.1, 0.2],
        "id": ["a", "b, c", "#7"],
        "kind": ["car", "van", "car"],
    }


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (text(end=",1"), "rows have 6 fields, the header 5: line 2"),
        (text() + "0.6,9", "rows have 2 fields, the header 5: line 8"),
        (text(before="# made\n\n") + "0.6,9,0", "rows have 3 fields, the header 5: line 10"),
        (text().partition("\n")[2], "there is no header: the first line is 0.0000"),
        ("# t,x\n" + text().partition("\n")[2], "there is no header"),
        ("", "has no header"),
        ("# only\n# comments\n", "has no header"),
        (text().replace("yaw", "x"), "two columns are called x"),
    ],
)
def test_rows_that_do_not_fit_the_header_are_refused(
    tmp_path: Path, content: str, words: str
) -> None:
    (tmp_path / "ego.csv").write_text(content)
    with pytest.raises(LogError) as error:
        load_table(tmp_path / "ego.csv")
    assert words in str(error.value) and "\n" not in str(error.value) and error.value.remedy
