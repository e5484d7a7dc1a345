"""OpenDRIVE maps in the place of a log's road, by pyxodr.

Skipped where the extra `opendrive` is not installed.
"""

from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from lanelet2_cases import driven_along, through

from replan.core.errors import LogError
from replan.logs.maps import MapFile, read_map
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.logs.road import IN_JUNCTION

needs_pyxodr = pytest.mark.skipif(
    find_spec("pyxodr") is None, reason="pyxodr (extra opendrive) is not installed"
)
CURVATURE = 0.02
LANES = """
<laneSection s="0">
 <left><lane id="1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/><roadMark sOffset="0" type="solid"/>
  <speed sOffset="0" max="30" unit="mph"/></lane></left>
 <center><lane id="0" type="none"><roadMark sOffset="0" type="broken solid"/></lane></center>
 <right><lane id="-1" type="driving"><width sOffset="0" a="3.0" b="0" c="0" d="0"/><roadMark sOffset="0" type="broken"/>
  <link><successor id="-1"/></link></lane>
  <lane id="-2" type="driving"><width sOffset="0" a="3.0" b="0" c="0" d="0"/></lane>
  <lane id="-3" type="sidewalk"><width sOffset="0" a="2.0" b="0" c="0" d="0"/></lane></right>
</laneSection>"""  # noqa: E501
MAP = f"""<OpenDRIVE><header revMajor="1" revMinor="4"/>
<road name="" length="100" id="7" junction="-1"><link/>
 <type s="0" type="town"><speed max="50" unit="km/h"/></type>
 <planView><geometry s="0" x="10" y="20" hdg="0" length="50"><line/></geometry>
  <geometry s="50" x="60" y="20" hdg="0" length="50"><arc curvature="{CURVATURE}"/></geometry></planView>
 <lanes>{LANES}</lanes><signals><signal id="1"/></signals></road></OpenDRIVE>"""  # noqa: E501


def _written(tmp_path: Path, text: str = MAP) -> Path:
    path = tmp_path / "map.xodr"
    path.write_text(text, encoding="utf-8")
    return path


@needs_pyxodr
def test_lanes_of_a_line_and_an_arc(tmp_path: Path) -> None:
    found = read_map(_written(tmp_path))
    left, first, second, walk = found.road.lanes.values()
    assert [lane.drivable for lane in found.road.lanes.values()] == [True, True, True, False]
    assert (left.left_opposite, first.left_opposite, second.left_opposite) == (True, True, False)
    assert (first.right_neighbour, second.left_neighbour, left.right_neighbour) == (
        second.id,
        first.id,
        None,
    )
    # The broken part of the middle is the left one
    assert (left.left_crossable, first.left_crossable) == (True, False)
    assert (first.right_crossable, second.left_crossable, left.right_crossable) == (
        True,
        True,
        False,
    )
    assert (left.speed_limit, first.speed_limit) == pytest.approx(
        (13.4112, 50 / 3.6)
    ) and found.road.drives_on_right
    assert first.left[0] == pytest.approx([10.0, 20.0]) and left.left[-1] == pytest.approx(
        [10.0, 20.0], abs=0.01
    )
    middle, radius = np.array([60.0, 20.0 + 1.0 / CURVATURE]), 1.0 / CURVATURE
    for line, offset in (
        (first.left, 0.0),
        (first.right, 3.0),
        (second.right, 6.0),
        (left.right, -3.5),
    ):
        bent = line[line[:, 0] > 60.0]
        assert np.abs(np.hypot(*(bent - middle).T) - radius - offset).max() < 0.02
    assert walk.kind == "sidewalk" and found.notes == ("1 signals and signs are not read.",)


@needs_pyxodr
def test_real_maps(shared_data: Path, tmp_path: Path) -> None:
    counts = {}
    for name in ("straight_500m", "e6mini", "fabriksgatan"):
        lanes = read_map(shared_data / "osi" / f"{name}.xodr").road.lanes
        drivable = [lane for lane in lanes.values() if lane.drivable]
        counts[name] = (len(lanes), len(drivable), sum(len(lane.successors) for lane in drivable))
        for lane in drivable:
            for after in lane.successors:
                gap = np.vstack(
                    [lane.left[-1] - lanes[after].left[0], lane.right[-1] - lanes[after].right[0]]
                )
                assert np.hypot(*gap.T).max() < 0.05
    # As in the XML
    assert counts == {
        "straight_500m": (6, 2, 0),
        "e6mini": (14, 6, 0),
        "fabriksgatan": (44, 20, 24),
    }
    path = shared_data / "osi" / "fabriksgatan.xodr"
    road = read_map(path).road
    crossing = {
        i for i, lane in road.lanes.items() if IN_JUNCTION in lane.kind.split("+") and lane.drivable
    }
    # That lead into it
    ends = {lane.id for lane in road.lanes.values() if lane.drivable and len(lane.successors) > 1}
    assert (
        len(crossing) == 12
        and ends
        and all(set(road.lanes[i].successors) <= crossing for i in ends)
    )
    start = next(
        lane
        for lane in road.lanes.values()
        if lane.drivable and lane.successors and lane.length > 50.0
    )
    write_scenario(tmp_path / "drive.mcap", driven_along(through(road, start.id, 120.0)[1]))
    mapped = read_log(tmp_path / "drive.mcap", LogSettings(map=str(path)))
    assert len(mapped.road.lanes) == 44 and any(
        "OpenDRIVE map fabriksgatan.xodr" in note for note in mapped.notes
    )


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("<OpenDRIVE>", "is no OpenDRIVE"),
        ("<osm/>", "root element is <osm>"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><OpenDRIVE/>', "document type declaration"),
        (MAP.replace('length="50"', 'length="1e12"'), "longer than 1000 km"),
    ],
)
def test_what_is_no_opendrive_is_refused(text: str, word: str, tmp_path: Path) -> None:
    path = _written(tmp_path, text)
    with pytest.raises(LogError, match=word) as error:
        read_map(path)
    assert error.value.file == path


LANE = """<lane id="-1" type="driving"><link><predecessor id="-1"/><successor id="-1"/></link>
<width sOffset="0" a="3" b="0" c="0" d="0"/></lane>"""


def _line(length: float, shape: str = "<line/>", *, x: float = 0.0) -> str:
    return f'<geometry s="{x}" x="{x}" y="0" hdg="0" length="{length}">{shape}</geometry>'


def _section(s: float, lane: str = LANE) -> str:
    return f'<laneSection s="{s}"><right>{lane}</right></laneSection>'


def _road(name: str, plan: str, lanes: str = _section(0.0), link: str = "") -> str:
    return (
        f'<road id="{name}" '
        f'length="9"><link>{link}</link><planView>{plan}</planView><lanes>{lanes}</lanes></road>'
    )


def _read(tmp_path: Path, *roads: str, begin: str = "<OpenDRIVE>") -> MapFile:
    return read_map(_written(tmp_path, f"{begin}{''.join(roads)}</OpenDRIVE>"))


@needs_pyxodr
@pytest.mark.parametrize(
    ("shape", "simple"),
    [
        ('<arc curvature="0.0"/>', "<line/>"),
        ('<arc curvature="-1e-12"/>', "<line/>"),
        ('<spiral curvStart="0" curvEnd="0"/>', "<line/>"),
        ('<spiral curvStart="0.01" curvEnd="0.01"/>', '<arc curvature="0.01"/>'),
        (
            '<spiral curvStart="-0.01" curvEnd="-0.01000000001"/>',
            '<arc curvature="-0.010000000005"/>',
        ),
    ],
)
def test_a_curve_that_is_a_simpler_one_is_read_as_that(
    shape: str, simple: str, tmp_path: Path
) -> None:
    one, other = (_read(tmp_path, _road("1", _line(100.0, each))) for each in (shape, simple))
    assert np.abs(one.road.lanes[1].left - other.road.lanes[1].left).max() < 1e-9
    assert one.road.lanes[1].length == pytest.approx(100.0, rel=0.02) and one.notes == ()


@needs_pyxodr
@given(
    first=st.sampled_from([0.0, 0.01, -0.2, 1.5]),
    change=st.floats(-12.0, -0.5).map(lambda power: 10.0**power),
    length=st.floats(0.05, 60.0),
)
@settings(max_examples=30, deadline=None)
def test_any_spiral_ends_where_its_curvature_leads(
    first: float, change: float, length: float
) -> None:
    from replan.logs.maps.opendrive import read_opendrive

    s = np.linspace(0.0, length, 20_001)
    yaw = first * s + change * s**2 / (2.0 * length)
    step, middle = length / 20_000, 0.5 * (yaw[1:] + yaw[:-1])
    spiral = f'<spiral curvStart="{first!r}" curvEnd="{first + change!r}"/>'
    with TemporaryDirectory() as folder:
        file = _written(Path(folder), f"<OpenDRIVE>{_road('1', _line(length, spiral))}</OpenDRIVE>")
        lane = read_opendrive(file, {}).road.lanes[1]
    end = step * np.array([np.cos(middle).sum(), np.sin(middle).sum()])
    assert np.hypot(*(lane.left[-1] - end)) < 1e-3


NEXT = '<successor elementType="road" elementId="2" contactPoint="start"/>'
BAD_ROADS = [
    (_road("9", ""), "it has no length"),
    (_road("9", _line(50.0), lanes=""), "it has no lanes"),
    (_road("1", _line(50.0)), "another road has its id"),
    (_road("", _line(50.0)), "it has no id"),
    (
        _road("9", _line(20.0) + _line(30.0, "<nurbs/>", x=20.0)),
        "its geometry at s = 20.0 is none of line, arc",
    ),
    (_road("9", _line(20.0) + _line(-3.0, x=20.0)), "its geometry at s = 20.0 has the length -3 m"),
    (
        _road("9", _line(20.0, '<paramPoly3 bU="1e9" dV="0"/>')),
        "leads more than 100 times its length away",
    ),
    (
        _road("9", _line(20.0) + _line(9.0, "<arc/>", x=20.0)),
        "its geometry at s = 20.0: KeyError: 'curvature'",
    ),
    (
        _road("9", _line(50.0), _section(0.0, LANE.replace('a="3"', 'a="nan"'))),
        "its lane -1 at s = 0.0 is not finite",
    ),
    (
        _road("9", _line(50.0), _section(0.0, LANE.replace('a="3"', 'a="wide"'))),
        "could not convert string to float",
    ),
    (
        _road("9", _line(50.0).replace('length="50.0"', 'length="far"')),
        "could not convert string to float",
    ),
]


@needs_pyxodr
@pytest.mark.parametrize(("bad", "why"), BAD_ROADS)
def test_a_road_that_cannot_be_read_is_named_and_the_others_are_read(
    bad: str, why: str, tmp_path: Path
) -> None:
    found = _read(
        tmp_path, _road("1", _line(40.0), link=NEXT), bad, _road("2", _line(60.0, x=40.0))
    )
    assert [lane.successors for lane in found.road.lanes.values()] == [(2,), ()]
    (note,) = found.notes
    name = bad.partition('id="')[2].partition('"')[0]
    assert note.startswith(f"1 road cannot be read: road {name}: ") and why in note
    with pytest.raises(LogError, match=r"map\.xodr: no lane .*1 road cannot be read") as error:
        _read(tmp_path, bad.replace('id="1"', 'id=""'))
    assert error.value.file == tmp_path / "map.xodr"


@needs_pyxodr
@pytest.mark.parametrize(
    ("link", "lane", "successors", "note"),
    [
        (NEXT, LANE, (2,), None),
        (NEXT.replace(' contactPoint="start"', ""), LANE, (2,), None),
        (NEXT.replace(' elementType="road"', ""), LANE, (2,), None),
        (
            NEXT,
            LANE.replace("<successor", '<successor id="-7"/><successor'),
            (2,),
            "to lane -7 of road 2",
        ),
        (NEXT.replace('"2"', '"77"'), LANE, (), "from lane -1 of road 1 to lane -1 of road 77"),
        (NEXT.replace('"road"', '"junction"'), LANE, (), None),
        ("", LANE, (), None),
        (NEXT, LANE.replace('<successor id="-1"/>', ""), (), None),
        (NEXT + NEXT, LANE, (2,), None),
    ],
)
def test_links_that_are_missing_or_lead_nowhere(
    link: str, lane: str, successors: tuple[int, ...], note: str | None, tmp_path: Path
) -> None:
    second = LANE.replace('<predecessor id="-1"/>', "").replace('<successor id="-1"/>', "")
    roads = (
        _road("1", _line(40.0), _section(0.0, lane), link),
        _road("2", _line(60.0, x=40.0), _section(0.0, second)),
    )
    found = _read(tmp_path, *roads)
    assert found.road.lanes[1].successors == successors
    assert len(found.notes) == (note is not None) and all(
        note in each for each in found.notes if note
    )


@needs_pyxodr
def test_a_link_of_one_lane_joins_both_and_the_nearer_end_is_meant(tmp_path: Path) -> None:
    back = '<predecessor elementType="road" elementId="1"/>'
    against = '<geometry s="0" x="100" y="0" hdg="3.141592653589793" length="60"><line/></geometry>'
    left = LANE.replace('id="-1" type', 'id="1" type').replace('<successor id="-1"/>', "")
    roads = _road("1", _line(40.0)), _road("2", _line(60.0, x=40.0), link=back)
    assert _read(tmp_path, *roads).road.lanes[1].successors == (2,)
    opposite = _road(
        "2",
        against,
        f'<laneSection s="0"><left>{left}</left></laneSection>',
        NEXT.replace('"2" contactPoint="start"', '"1"'),
    )
    opposite = opposite.replace('<predecessor id="-1"/>', '<successor id="-1"/>')
    assert _read(tmp_path, roads[0], opposite).road.lanes[1].successors == (2,)


@needs_pyxodr
def test_lane_sections_of_no_or_little_length(tmp_path: Path) -> None:
    renamed = LANE.replace('id="-1" type', 'id="-4" type')
    to_4, from_4 = (
        LANE.replace('successor id="-1"', 'successor id="-4"'),
        LANE.replace('predecessor id="-1"', 'predecessor id="-4"'),
    )
    after = _road("2", _line(60.0, x=40.0))
    for lanes, links in (
        (_section(0.0, to_4) + _section(40.0, renamed), {1: (2,), 2: ()}),
        (_section(0.0, to_4) + _section(90.0, renamed), {1: (2,), 2: ()}),
        (_section(0.0, renamed) + _section(0.0, from_4), {1: (2,), 2: ()}),
        (
            _section(0.0, to_4) + _section(20.0, renamed) + _section(20.0, from_4),
            {1: (2,), 2: (3,), 3: ()},
        ),
        (
            _section(20.0, from_4) + _section(0.0, renamed + LANE),
            {1: (3,), 2: (3,), 3: (4,), 4: ()},
        ),
        (_section(0.0) + _section(39.99), {1: (2,), 2: (3,), 3: ()}),
        (_section(0.0) + _section(20.0) + _section(20.03), {1: (2,), 2: (3,), 3: (4,), 4: ()}),
    ):
        found = _read(tmp_path, _road("1", _line(40.0), lanes, NEXT), after)
        assert {lane.id: lane.successors for lane in found.road.lanes.values()} == links, lanes
        assert found.notes == () and found.road.lanes[1].left[0] == pytest.approx([0.0, 0.0])


@needs_pyxodr
def test_short_roads_and_tight_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # pyxodr draws what it does not expect
    after = _road("2", _line(60.0, x=0.05))
    found = _read(tmp_path, _road("1", _line(0.05), link=NEXT), after)
    assert found.road.lanes[1].successors == (2,) and found.road.lanes[1].length == pytest.approx(
        0.05
    )
    for shape in (
        '<arc curvature="-5"/>',
        '<spiral curvStart="-4" curvEnd="-6"/>',
        '<arc curvature="-0.7"/>',
    ):
        line = _read(tmp_path, _road("1", _line(0.29, shape))).road.lanes[1].left
        assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(0.29, rel=0.02)
    assert [file.name for file in tmp_path.iterdir()] == ["map.xodr"]


@needs_pyxodr
def test_elements_that_are_missing_or_out_of_order(tmp_path: Path) -> None:
    plain = _read(tmp_path, _road("1", _line(50.0))).road.lanes[1]
    widths = (
        '<width sOffset="20" a="4" b="0" c="0" d="0"/><width sOffset="0" a="3" b="0" c="0" d="0"/>'
    )
    border = '<border sOffset="0" a="-9" b="0" c="0" d="0"/></lane>'
    bare = '<lane id="-1" type="driving"/>'
    named = '<OpenDRIVE xmlns="http://code.asam.net/simulation/standard/opendrive_schema">'
    for begin, lane, heights in (
        (named, LANE, ""),
        ("<OpenDRIVE>", LANE.replace("</lane>", border), ""),
        ("<OpenDRIVE>", LANE, '<elevationProfile><elevation s="0"/></elevationProfile>'),
    ):
        road = _road("1", _line(50.0), _section(0.0, lane)).replace(
            "<planView>", f"{heights}<planView>"
        )
        assert np.array_equal(_read(tmp_path, road, begin=begin).road.lanes[1].right, plain.right)
    wider = _read(
        tmp_path,
        _road("1", _line(50.0), _section(0.0, f'<lane id="-1" type="driving">{widths}</lane>')),
    )
    line = wider.road.lanes[1].right
    assert (
        set(np.round(line[:, 1])) == {-3.0, -4.0} and (line[line[:, 0] > 20.1][:, 1] == -4.0).all()
    )
    outer = LANE.replace('id="-1" type', 'id="-2" type')
    found = _read(
        tmp_path, _road("1", _line(50.0), _section(0.0, bare + outer)), _road("2", _line(50.0))
    )
    assert np.array_equal(found.road.lanes[1].right, plain.right)
    assert found.notes == ("1 lane is incomplete: lane -1 of road 1 has no width.",)
    untyped = _read(
        tmp_path,
        _road("1", _line(50.0), _section(0.0, LANE.replace(' type="driving"', "") + outer)),
    )
    assert len(untyped.road.lanes) == 1 and "lane -1 of road 1 has no type" in untyped.notes[0]


@pytest.mark.skipif(find_spec("pyxodr") is not None, reason="pyxodr is installed")
def test_without_the_library_the_remedy_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        LogError, match=r"OpenDRIVE needs pyxodr; pip install 'replan\[opendrive\]'"
    ):
        read_map(_written(tmp_path))
