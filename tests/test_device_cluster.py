"""Work on views by a Dask cluster: the same bits even if workers die, and clear errors."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster

from fipt_blender.cli.arguments import make_options, make_parser
from fipt_blender.core.capture.views import View
from fipt_blender.core.device import cluster
from fipt_blender.core.estimate import command, training_stages
from fipt_blender.core.material import training
from fipt_blender.core.pixels.store import ViewFunction, trace_view
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs.scene_steps import estimate_step
from samples import small_captures as samples
from samples.child_processes import PATIENCE_SECONDS
from samples.refusals import error_of
from samples.small_captures import SmallCapture, pinhole, write_run
from samples.small_rooms import BOX, make_room, table

# Every stage, and next to no training: that is not shared.
LITTLE = {**samples.FEW, "training_steps": 2, "roughness_levels": 3, "refine_depth": 2}


@pytest.fixture(scope="module")
def two() -> Iterator[LocalCluster]:
    """A cluster of two processes."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
        yield found


@pytest.fixture
def empty() -> Iterator[LocalCluster]:
    """A scheduler without workers."""
    with LocalCluster(n_workers=0, processes=True, dashboard_address=":0") as found:
        yield found


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    """The box with a panel, photographed quickly."""
    room = make_room([*BOX, samples.PANEL], parts="objects", objects=np.arange(7))
    materials = samples.matt(np.repeat(np.array([*samples.COLORS, [0.0] * 3]), 2, axis=0))
    lamps = table(samples.PANEL_TRIANGLES, samples.PANEL_RADIANCE)
    return samples.photograph_room(room, materials, lamps, cameras=samples.CAMERAS[:4], spp=16)


def views(capture: SmallCapture) -> list[View]:
    poses = 3 * capture.poses
    return [View(str(i), "train", Path("none.exr"), **vars(pinhole(pose))) for i, pose in enumerate(poses)]


class Killer(Reporter):
    """Kills a worker of a cluster once, amid the refinement."""

    address = current = killed = ""

    def stage(self, name: str, text: str) -> None:
        self.current = name
        super().stage(name, text)

    def progress(self, stage_fraction: float, *arguments, **options) -> None:
        super().progress(stage_fraction, *arguments, **options)
        if self.current == "refinement-1" and 0.0 < stage_fraction < 1.0 and not self.killed:
            self.killed = kill_a_busy_worker(self.address)


def estimated(root: Path, capture: SmallCapture, address: str | None, reporter: Reporter) -> RunFolder:
    run = write_run(root, capture, **LITTLE)
    command.run(argparse.Namespace(run=run.root, cluster=address, anew=False), reporter)
    return run


def files(run: RunFolder) -> dict[str, bytes]:
    """The bytes of all files with data per pixel, and of the emitters."""
    found = [*run.stage.glob("*/*.npy"), run.emitters_json]
    return {path.relative_to(run.root).as_posix(): path.read_bytes() for path in found}


def kill_a_busy_worker(address: str) -> str:
    """Like a machine that is switched off while it works on views; returns the worker's address."""
    with Client(address, set_as_default=False) as client:
        busy = [worker for worker, keys in client.processing().items() if keys]
        pids = client.run(os.getpid)
    os.kill(pids[busy[0]], signal.SIGKILL)
    return busy[0]


def work_error(cluster_: LocalCluster, capture: SmallCapture, items: Iterable[View]) -> FiptError:
    """With what the work on views ends."""
    with cluster.workers_at(cluster_.scheduler_address) as workers:
        return error_of(lambda: list(workers.map(ViewFunction(trace_view, (capture.room,)), items)))


def test_a_cluster_finds_the_same_bits_though_a_worker_is_killed(
    two: LocalCluster, capture: SmallCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (training_stages, training):
        monkeypatch.setattr(module, "PRETRAINING_STEPS", 2)
    here = files(estimated(tmp_path / "here", capture, None, Reporter()))
    killer = Killer()
    killer.address = two.scheduler_address
    there = files(estimated(tmp_path / "there", capture, two.scheduler_address, killer))
    assert killer.killed
    assert here.keys() == there.keys() and len(here) > 15
    assert [name for name in here if here[name] != there[name]] == []
    with Client(two.scheduler_address, set_as_default=False) as client:
        assert client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)) == 0  # all released


def test_a_worker_of_another_version_or_method_is_named(
    two: LocalCluster, capture: SmallCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value, text in (("PRODUCT_VERSION", "99.0", "99.0"), ("method_digest", lambda: "another", "another")):
        with monkeypatch.context() as patch:
            patch.setattr(cluster, name, value)
            caught = work_error(two, capture, views(capture))
        assert caught.code == "cluster-worker-unfit" and text in caught.text and "mitsuba" in caught.text


def test_a_worker_without_the_engine_is_named_at_once(
    empty: LocalCluster, capture: SmallCapture, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "dask", "worker", empty.scheduler_address]
    command += ["--no-nanny", "--no-dashboard"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL) as worker:
        try:
            with Client(empty.scheduler_address, set_as_default=False) as client:
                client.wait_for_workers(1, timeout=PATIENCE_SECONDS)
            caught = work_error(empty, capture, views(capture))
        finally:
            worker.terminate()
    assert caught.code == "cluster-worker-unfit" and "fipt_blender" in caught.text
    assert "worker at tcp://" in caught.text and "cluster.md" in caught.remedy


def test_a_scheduler_without_workers(
    empty: LocalCluster, capture: SmallCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "WORKERS_SECONDS", 0.5)
    monkeypatch.setattr(cluster, "POLL_SECONDS", 0.2)
    taken = []

    def items() -> Iterator[View]:
        for view in views(capture):
            taken.append(view)
            yield view

    caught = work_error(empty, capture, items())
    assert caught.code == "cluster-no-worker" and "Start workers" in caught.remedy
    assert 0 < len(taken) < len(views(capture)) / 2  # the rest was never read


def test_a_scheduler_that_dies(empty: LocalCluster, capture: SmallCapture, monkeypatch) -> None:
    def items() -> Iterator[View]:
        yield views(capture)[0]
        empty.close()
        yield views(capture)[1]

    caught = work_error(empty, capture, items())
    assert caught.code == "cluster-lost" and "resume" in caught.remedy


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "tcp://no.such.host.invalid:8786", ""])
def test_an_address_where_nothing_answers(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.5)
    made = []  # the __del__ of a client that never connected may block any thread forever
    monkeypatch.setattr(Client, "__init__", lambda self, *arguments, **options: made.append(arguments))
    caught = error_of(cluster.workers_at(address).__enter__)
    assert caught.code == "cluster-unreachable" and repr(address) in caught.text and not made


def test_the_address_reaches_the_engine(tmp_path: Path) -> None:
    arguments = make_parser().parse_args(["estimate", "room", "--cluster", "tcp://host:8786"])
    options = make_options(arguments)
    assert options.cluster == "tcp://host:8786"
    run = RunFolder(tmp_path)
    for address, more in ((options.cluster, ["--cluster=tcp://host:8786"]), (None, [])):
        assert estimate_step(run, options.settings, True, address).command == ["estimate", str(run.root), *more]


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    caught = error_of(cluster.workers_at("tcp://127.0.0.1:9").__enter__)
    assert caught.code == "package-optional" and "extra_cluster.txt" in caught.remedy


def test_a_cluster_on_another_machine_without_tls_is_warned_of() -> None:
    for address in (None, "tls://far:8786", "tcp://127.0.0.1:1", "tcp://[::1]:1"):
        assert cluster.unprotected(address) is None, address
    for address in ("tcp://far:8786", "far:8786", "ws://far:1", "tcp://10.0.0.2:8786"):
        assert f"--cluster tls://{address.partition('://')[2] or address}" in cluster.unprotected(address)[2]
