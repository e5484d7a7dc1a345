"""OpenDRIVE maps in the place of a log's road, by pyxodr; skipped where the extra `opendrive` is not installed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from lanelet2_cases import driven_along, through

from logs import LogError
from logs.maps import read_map
from logs.mcap import write_scenario
from logs.readers import LogSettings, read_log

needs_pyxodr = pytest.mark.skipif(find_spec("pyxodr") is None, reason="pyxodr (extra opendrive) is not installed")
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
</laneSection>"""
MAP = f"""<OpenDRIVE><header revMajor="1" revMinor="4"/>
<road name="" length="100" id="7" junction="-1"><link/>
 <type s="0" type="town"><speed max="50" unit="km/h"/></type>
 <planView><geometry s="0" x="10" y="20" hdg="0" length="50"><line/></geometry>
  <geometry s="50" x="60" y="20" hdg="0" length="50"><arc curvature="{CURVATURE}"/></geometry></planView>
 <lanes>{LANES}</lanes><signals><signal id="1"/></signals></road></OpenDRIVE>"""


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
    assert (first.right_neighbour, second.left_neighbour, left.right_neighbour) == (second.id, first.id, None)
    assert (left.left_crossable, first.left_crossable) == (True, False)  # the broken part of the middle is the left one
    assert (first.right_crossable, second.left_crossable, left.right_crossable) == (True, True, False)
    assert (left.speed_limit, first.speed_limit) == pytest.approx((13.4112, 50 / 3.6)) and found.road.drives_on_right
    assert first.left[0] == pytest.approx([10.0, 20.0]) and left.left[-1] == pytest.approx([10.0, 20.0], abs=0.01)
    middle, radius = np.array([60.0, 20.0 + 1.0 / CURVATURE]), 1.0 / CURVATURE
    for line, offset in ((first.left, 0.0), (first.right, 3.0), (second.right, 6.0), (left.right, -3.5)):
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
                gap = np.vstack([lane.left[-1] - lanes[after].left[0], lane.right[-1] - lanes[after].right[0]])
                assert np.hypot(*gap.T).max() < 0.05
    assert counts == {"straight_500m": (6, 2, 0), "e6mini": (14, 6, 0), "fabriksgatan": (44, 20, 24)}  # as in the XML
    path = shared_data / "osi" / "fabriksgatan.xodr"
    road = read_map(path).road
    start = next(lane for lane in road.lanes.values() if lane.drivable and lane.successors and lane.length > 50.0)
    write_scenario(tmp_path / "drive.mcap", driven_along(through(road, start.id, 120.0)[1]))
    mapped = read_log(tmp_path / "drive.mcap", LogSettings(map=str(path)))
    assert len(mapped.road.lanes) == 44 and any("OpenDRIVE map fabriksgatan.xodr" in note for note in mapped.notes)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("<OpenDRIVE>", "is no OpenDRIVE"),
        ("<osm/>", "root element is <osm>"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><OpenDRIVE/>', "document type declaration"),
        (MAP.replace('length="50"', 'length="1e12"'), "more than 1000 km"),
        (MAP.replace('length="50"', 'length="far"'), "is no OpenDRIVE"),
        (MAP.replace("<line/>", '<paramPoly3 bU="1e9" dV="0"/>'), "leads more than 100 times its length away"),
    ],
)
def test_what_is_no_opendrive_is_refused(text: str, word: str, tmp_path: Path) -> None:
    path = _written(tmp_path, text)
    with pytest.raises(LogError, match=word) as error:
        read_map(path)
    assert error.value.file == path


@needs_pyxodr
def test_what_the_library_cannot_read_is_an_error(tmp_path: Path) -> None:
    for text in (MAP.replace('a="3.5"', 'a="wide"'), MAP.replace("driving", "none"), MAP.replace('id="7"', "")):
        with pytest.raises(LogError, match=r"map\.xodr"):
            read_map(_written(tmp_path, text))


@pytest.mark.skipif(find_spec("pyxodr") is not None, reason="pyxodr is installed")
def test_without_the_library_the_remedy_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"OpenDRIVE needs pyxodr; pip install 'replan\[opendrive\]'"):
        read_map(_written(tmp_path))
