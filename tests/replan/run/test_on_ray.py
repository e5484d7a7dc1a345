"""Ray: the bytes of the local engine; a node that dies costs a retry; what a node lacks is said."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from short_logs import QUICK, identical, short

from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results
from replan.logs.mcap import write_scenario
from replan.run import evaluate_logs
from replan.run.on_ray import OnRay, code_of

# Ray leaves files open
pytestmark = [pytest.mark.slow, pytest.mark.nightly, pytest.mark.filterwarnings("ignore")]
ray: Any = pytest.importorskip(
    "ray", reason="the extra ray is not installed: pip install 'replan[ray]'"
)

PLANNER = '''
import os, pathlib, signal, time
import manner
import ray
from replan.planners.constant_speed import ConstantSpeed

class Slow(ConstantSpeed):
    """Says where it drives, and takes its time."""
    def plan(self, frame):
        if frame.t == 0.0:
            folder = pathlib.Path(manner.FOLDER)
            node = ray.get_runtime_context().get_node_id() if ray.is_initialized() else ""
            (folder / f"{node}-{time.monotonic_ns()}").touch()
            time.sleep(manner.PAUSE_S)
        return super().plan(frame)

class Killing(ConstantSpeed):
    """Ends its process where anybody else is in the scene."""
    def plan(self, frame):
        if len(frame.agents):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().plan(frame)
'''


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for k in range(6):
        write_scenario(folder / f"{k}.mcap", short(f"test/{k}", v=6.0 + k, parked=k == 3))
    return folder


@pytest.fixture
def slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder into which a planner, a module beside which is imported, says that a drive has
    begun.
    """
    said = tmp_path / "said"
    said.mkdir()
    code = tmp_path / "code"
    code.mkdir()
    (code / "slow_planner.py").write_text(PLANNER, encoding="utf-8")
    (code / "manner.py").write_text(f"FOLDER = {str(said)!r}\nPAUSE_S = 1.0\n", encoding="utf-8")
    monkeypatch.chdir(code)
    monkeypatch.syspath_prepend(str(code))
    return said


@pytest.fixture
def nodes() -> Iterator[Any]:
    """A cluster of two nodes on this machine; the first is the driver's."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    try:
        cluster.second = cluster.add_node(num_cpus=1)
        yield cluster
    finally:
        cluster.shutdown()


def trusted(*planners: str) -> Any:
    return replace(
        QUICK,
        planners=planners,
        loop=replace(QUICK.loop, apart=replace(QUICK.loop.apart, trust=True)),
    )


def run(logs: Path, out: Path, config: Any, engine: OnRay | None = None, **options: Any) -> Results:
    return evaluate_logs([logs], config, out, engine=engine, **options)


def test_two_nodes_of_which_one_is_killed_give_the_bytes_of_this_process(
    logs: Path, slow: Path, nodes: Any, tmp_path: Path
) -> None:
    config = trusted("slow_planner:Slow")

    def kill() -> None:
        while not list(slow.glob(f"{nodes.second.node_id}-*")):
            time.sleep(0.02)
        nodes.remove_node(nodes.second, allow_graceful=False)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    there = run(logs, tmp_path / "ray", config, OnRay(nodes.address))
    killer.join(60.0)
    drives = len(list(slow.iterdir()))
    here = run(logs, tmp_path / "here", config)
    assert not len(there.failures)
    assert identical(here.path, there.path)
    assert (here.path / "verdicts.parquet").read_bytes() == (
        there.path / "verdicts.parquet"
    ).read_bytes()
    # Open and closed loop of six logs, and what was begun on the node that died
    assert drives > 2 * 6


def test_on_this_machine_a_worker_that_dies_costs_its_log(
    logs: Path, slow: Path, tmp_path: Path
) -> None:
    result = run(
        logs, tmp_path / "out", trusted("slow_planner:Killing", "constant_speed"), OnRay(workers=2)
    )
    assert [failure.log for failure in result.failures.itertuples()] == [str(logs / "3.mcap")]
    assert "lost on the cluster after 4 tries" in result.failures.iloc[0].message
    assert len(result.drives) == 5 * 4


LISTENS = """\
import os, sys
from pathlib import Path
from replan.config import RunConfig
from replan.run.on_ray import OnRay


def listening():
    rows = [row.split() for name in ("tcp", "tcp6") for row in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {row[1] for row in rows if row[3] == "0A"}


before = listening()
with OnRay(workers=1)._ray_connection(RunConfig()) as ray:
    assert ray.get(ray.remote(lambda: os.environ["RAY_USAGE_STATS_ENABLED"]).remote()) == "0"
    print(*listening() - before)
print(*Path(sys.argv[1]).iterdir())
"""  # noqa: E501


@pytest.mark.skipif(sys.platform != "linux", reason="sockets are read from /proc")
def test_on_this_machine_it_listens_on_the_loopback_alone_and_leaves_no_files() -> None:
    root = str(Path(__file__).parents[3])
    with tempfile.TemporaryDirectory(prefix="r") as scratch:  # paths of sockets are short
        done = subprocess.run(
            [sys.executable, "-c", LISTENS, scratch],
            capture_output=True,
            text=True,
            check=True,
            cwd=root,
            env={**os.environ, "TMPDIR": scratch},
        )
    sockets, left = done.stdout.splitlines()
    assert sockets and all(one.split(":")[0].endswith("0100007F") for one in sockets.split()), (
        sockets
    )
    assert not left


def test_a_log_that_no_node_sees_and_other_code_are_said(
    logs: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    from replan.run import on_ray
    from replan.run.log_source import LogSource

    stamp = on_ray.stamp_of(QUICK)
    gone = LogSource("gone.mcap", tmp_path / "gone.mcap")
    result, files = on_ray._on_node(gone, (QUICK, stamp, "one"))
    assert "must lie in a folder that all nodes share" in result.failures[0].message and not files
    result, files = on_ray._on_node(
        LogSource("a", logs / "0.mcap"), (QUICK, replace(stamp, code="f" * 64), "one")
    )
    assert "install there what is here" in result.failures[0].message and not files


def test_only_the_users_code_is_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / "mine"
    (mine / "my_fleet" / "weights").mkdir(parents=True)
    (mine / "my_fleet" / "__init__.py").write_text("")
    (mine / "my_fleet" / "planner.py").write_text("class Mine: ...")
    (mine / "my_fleet" / "weights" / "w.bin").write_bytes(b"\1")
    (mine / "beside.py").write_text("")
    (mine / "huge.mcap").write_bytes(b"\0")
    monkeypatch.chdir(mine)
    monkeypatch.syspath_prepend(str(mine))
    target = tmp_path / "sent"
    target.mkdir()
    code_of(
        replace(QUICK, planners=("dp_qp", "my_fleet.planner:Mine", "replan.planners.idm:Idm")),
        target,
    )
    sent = {path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file()}
    assert sent == {
        "beside.py",
        "my_fleet/__init__.py",
        "my_fleet/planner.py",
        "my_fleet/weights/w.bin",
    }


def test_no_cluster_at_the_address_is_one_line(logs: Path, tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"--address 127.0.0.1:1: no connection: .*ray start --head"
    ):
        run(logs, tmp_path / "out", QUICK, OnRay("127.0.0.1:1"))


def test_code_of_a_controller_is_sent_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_sent_controller.py").write_text(
        "def mine(*_):\n    raise ValueError\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    target = tmp_path / "sent"
    target.mkdir()
    code_of(replace(QUICK, loop=replace(QUICK.loop, controller="my_sent_controller:mine")), target)
    assert (target / "my_sent_controller.py").is_file()
