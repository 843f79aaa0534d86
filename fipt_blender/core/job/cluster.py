# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work on views by the processes of a Dask cluster, which may be other machines without a disk in common.

`distributed` is imported, and the network touched, only where an address is given. What travels are bytes
that Dask makes of arrays and numbers: a worker chooses its variant before it unpacks them, and the scheduler
never does. docs/architecture.md says how to start a cluster.
"""

from __future__ import annotations

import asyncio
import hashlib
import importlib
import importlib.metadata
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..device.variant import VARIANTS, set_variant
from .errors import FiptError
from .per_view import Item, LocalWorkers, Result, ViewWork, Workers
from .runfolder import PRODUCT_VERSION

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_SECONDS = 5.0
# More than the transport's own limit, so that its error, which says more, comes first.
_GRACE_SECONDS = 1.0
# Without any worker for so long, a run gives up; one that was restarted is back by then.
WORKERS_SECONDS = 60.0
_POLL_SECONDS = 2.0
# Views on their way for each worker, so that none waits for its next one.
_AHEAD = 2
# Packages whose versions decide on a result's last bits.
_PACKAGES = ("mitsuba", "drjit", "pyoidn")
# Dr.Jit has one state a process, so a worker of several threads does one view after the other.
_lock = threading.Lock()
# The stage that this worker is at: the key of its work, and the prepared function of one view.
_stage: tuple[str, Callable[[Any], Any]] | None = None


@dataclass(frozen=True)
class Needs:
    """What a worker must have in common with the process that it works for."""

    product: str
    device: str
    packages: dict[str, str]


@contextmanager
def workers_at(address: str | None) -> Iterator[Workers]:
    """The workers of the cluster whose scheduler has this address; this process where it is None.

    Args:
        address: as the user gave it, e.g. ``tcp://host:8786``.

    Raises:
        FiptError: ``package-missing``, ``cluster-unreachable``; while views are worked on
            ``cluster-worker-unfit``, ``cluster-no-worker`` and ``cluster-lost``.
    """
    if address is None:
        yield LocalWorkers()
        return
    with _connect(address) as client:
        yield ClusterWorkers(client)


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise FiptError(
            "package-missing",
            f"A cluster was asked for, and the engine's Python lacks a package ({error}).",
            f"Install it with: {sys.executable} -m pip install distributed",
        ) from None
    # The room and its cache are far larger than a task's usual arguments.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
        # Never a client that can't connect: when it is collected, its __del__ may wait for ever for a lock of
        # `distributed` that the thread holds on which the collection happened to start.
        if (reason := _silent(address)) is not None:
            raise _unreachable(address, reason)
        try:
            client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except Exception as error:  # it answered, and went since
            raise _unreachable(address, str(error)) from None
        try:
            yield client
        finally:
            client.close(timeout=CONNECT_SECONDS)


def _unreachable(address: str, reason: str) -> FiptError:
    return FiptError(
        "cluster-unreachable",
        f"No Dask scheduler answers at '{address}' ({reason}).",
        "Check the address, which `dask scheduler` prints, and that a firewall lets it through; or leave "
        "--cluster out.",
    )


def _silent(address: str) -> str | None:
    """Why no scheduler answers there within `CONNECT_SECONDS`; None where one does."""
    from distributed.core import rpc
    from distributed.security import Security

    async def ask() -> None:
        security = Security().get_connection_args("client")
        async with rpc(address, timeout=CONNECT_SECONDS, connection_args=security) as scheduler:
            await scheduler.identity()

    def run() -> None:
        try:
            asyncio.run(ask())
            reasons[0] = None
        except Exception as error:  # each transport has its own
            reasons[0] = str(error) or type(error).__name__

    reasons: list[str | None] = [f"no answer within {CONNECT_SECONDS:.0f} seconds"]
    # Looking a name up can't be interrupted and may take minutes; nobody waits for a daemon.
    thread = threading.Thread(target=run, name="fipt-scheduler", daemon=True)
    thread.start()
    thread.join(CONNECT_SECONDS + _GRACE_SECONDS)
    return reasons[0]


class ClusterWorkers:
    """Work on views by a cluster; see :class:`per_view.Workers`.

    Views of a worker that is lost are worked on by others, with the same result.
    """

    def __init__(self, client: Client) -> None:
        import mitsuba

        device = next(name for name, variant in VARIANTS.items() if variant == mitsuba.variant())
        self._client = client
        self._needs = Needs(PRODUCT_VERSION, device, _versions())

    def map(self, work: ViewWork[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result]]:
        """See :class:`per_view.Workers`.

        Raises:
            FiptError: see :func:`workers_at`; or what a worker raised.
        """
        from distributed.protocol import serialize_bytes

        self._check_imports()
        packed = serialize_bytes(work)
        stage_key = hashlib.sha256(packed).hexdigest()
        name = f"fipt-{uuid.uuid4().hex}"  # keys of other clients' and earlier work are their own
        stage = self._client.submit(_keep, packed, key=f"{name}-stage")
        del packed
        remaining = enumerate(items)
        pending: dict[Future, int] = {}
        try:
            while True:
                for index, item in _take(remaining, _AHEAD * max(1, self._count()) - len(pending)):
                    arguments = (self._needs, stage_key, stage, serialize_bytes(item))
                    pending[self._client.submit(_work_on, *arguments, key=f"{name}-{index}")] = index
                if not pending:
                    return
                for future in self._wait(list(pending)):
                    index = pending.pop(future)
                    yield index, _result(future)
        finally:
            self._client.cancel([stage, *pending])

    def _check_imports(self) -> None:
        """Whether the workers have the engine: one without it would end at its first view, telling nobody.

        Raises:
            FiptError: ``cluster-worker-unfit``.
        """
        with _answered():
            found = self._client.run(importlib.import_module, __name__, on_error="return")
        for address, result in found.items():
            if isinstance(result, ImportError):
                raise _unfit(f"The worker at {address}", result) from result

    def _count(self) -> int:
        """Workers that are there now."""
        with _answered():
            return len(self._client.nthreads())

    def _wait(self, futures: list[Future]) -> list[Future]:
        """Those that have ended, at least one."""
        from distributed import wait

        alone_since = time.monotonic()
        while True:
            with _answered(), self._client.as_current():
                try:
                    return list(wait(futures, timeout=_POLL_SECONDS, return_when="FIRST_COMPLETED").done)
                except TimeoutError:
                    pass
            if self._count():
                alone_since = time.monotonic()
            if time.monotonic() - alone_since > WORKERS_SECONDS:
                raise FiptError(
                    "cluster-no-worker",
                    f"The cluster had no worker for {WORKERS_SECONDS:.0f} seconds.",
                    "Start workers as docs/architecture.md says and resume the run. Where there had been "
                    "some, their logs tell why they ended.",
                )


def _take(remaining: Iterator[tuple[int, Item]], count: int) -> Iterator[tuple[int, Item]]:
    """The next items, up to a number of them."""
    for _ in range(count):
        try:
            yield next(remaining)
        except StopIteration:
            return


@contextmanager
def _answered() -> Iterator[None]:
    """Turn the loss of the scheduler into ``cluster-lost``."""
    from distributed import CancelledError

    try:
        yield
    except (CancelledError, OSError) as error:
        raise FiptError(
            "cluster-lost",
            f"The connection to the cluster's scheduler was lost ({type(error).__name__}: {error}).",
            "Start the scheduler and its workers again, and resume the run with the new address.",
        ) from error


def _result(future: Future) -> Any:
    """What a worker found.

    Raises:
        FiptError: ``cluster-worker-unfit``, ``cluster-lost``, or what the worker raised.
    """
    from distributed import CancelledError
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise FiptError(
            "cluster-lost",
            f"Several workers died at the same view ({error}).",
            "Their logs tell why; often it is memory: start fewer workers on a machine.",
        ) from error
    except CancelledError as error:
        raise FiptError(
            "cluster-lost", f"The cluster dropped work ({error}).", "Start it again and resume the run."
        ) from error
    except (ImportError, AttributeError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "deserializ" not in str(error):
            raise  # of the work itself
        raise _unfit("The cluster", error) from error


def _unfit(who: str, error: Exception) -> FiptError:
    return FiptError(
        "cluster-worker-unfit",
        f"{who} can't import the engine ({type(error).__name__}: {' '.join(str(error).split())}).",
        "Start the scheduler and the workers with the Python and the version of the engine that run here; "
        "docs/architecture.md says how.",
    )


def _versions() -> dict[str, str]:
    """Version of each package that matters, "none" where it is missing."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "none"
    return found


# On the workers


def _keep(packed: bytes) -> bytes:
    """A stage's work as a result of its own: the workers fetch it once each, from one another."""
    return packed


def _work_on(needs: Needs, stage_key: str, stage: bytes, item: bytes) -> Any:
    """One view, in a worker."""
    from distributed.protocol import deserialize_bytes

    global _stage
    with _lock:
        _check(needs)
        if _stage is None or _stage[0] != stage_key:
            _stage = None  # frees the last one's memory first
            _stage = stage_key, deserialize_bytes(stage).prepare()
        return _stage[1](deserialize_bytes(item))


def _check(needs: Needs) -> None:
    """Choose the variant, where this worker has what it needs.

    Raises:
        FiptError: ``cluster-worker-unfit``.
    """
    own = Needs(PRODUCT_VERSION, needs.device, _versions())
    reason = "" if own == needs else f"it has {_spoken(own)}, and the run {_spoken(needs)}"
    try:
        if not reason:
            set_variant(needs.device)
    except (FiptError, ImportError, RuntimeError) as error:
        reason = error.text if isinstance(error, FiptError) else str(error)
    if reason:
        raise FiptError(
            "cluster-worker-unfit",
            f"The worker on {_host()} can't take part: {reason}.",
            "Start it with the engine's version and packages that the run has, or stop that worker.",
        )


def _spoken(needs: Needs) -> str:
    return ", ".join([f"fipt_blender {needs.product}", *(f"{n} {v}" for n, v in needs.packages.items())])


def _host() -> str:
    import platform

    return platform.node()
