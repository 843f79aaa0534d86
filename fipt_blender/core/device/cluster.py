"""Work on views by the processes of a Dask cluster, also on other machines without a shared disk.

`distributed` is imported and the network is used only if an address is given. Work is sent as bytes that Dask
makes of arrays and numbers: a worker chooses Mitsuba's variant before it unpacks them, and the scheduler
never unpacks them. docs/cluster.md describes how to start a cluster.
"""

from __future__ import annotations

import asyncio
import hashlib
import importlib
import platform
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from ..run.errors import FiptError
from ..run.extras import optional
from ..run.method import method_digest
from ..run.per_view import Item, LocalWorkers, Result, ViewWork, Workers
from ..run.runfolder import PRODUCT_VERSION
from .check import package_versions
from .variant import VARIANTS, set_variant

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_SECONDS = 5.0  # for the scheduler's first answer
# A run ends after this time without any worker; a worker that is restarted is back by then.
WORKERS_SECONDS = 60.0
POLL_SECONDS = 2.0
_THIS_MACHINE = ("localhost", "127.0.0.1", "::1")
# Packages whose versions affect the last bits of results.
_PACKAGES = ("mitsuba", "drjit", "pyoidn")
# Dr.Jit has one state per process, therefore a worker with several threads does one view at a time.
_lock = threading.Lock()
# In a worker: the key of the current stage's work, and its prepared function of one view.
_stage: tuple[str, Callable[[Any], Any]] | None = None


@dataclass(frozen=True)
class Needs:
    """What a worker must have in common with the process that it works for.

    Attributes:
        product: version of fipt_blender.
        method: digest of the engine's source code (:func:`method_digest`).
        device: ``"llvm"`` or ``"cuda"``.
        packages: version by name, None where one is missing.
    """

    product: str
    method: str
    device: str
    packages: dict[str, str | None]


@contextmanager
def workers_at(address: str | None) -> Iterator[Workers]:
    """The workers of a cluster, or this process if there is no address.

    Args:
        address: of the scheduler, as the user gave it, e.g. ``tcp://host:8786``.

    Raises:
        FiptError: ``package-optional``, ``cluster-unreachable``; during the work ``cluster-worker-unfit``,
            ``cluster-no-worker`` and ``cluster-lost``.
    """
    if address is None:
        yield LocalWorkers()
        return
    with _connect(address) as client:
        yield ClusterWorkers(client)


def unprotected(address: str | None) -> tuple[str, str, str] | None:
    """Code, text and remedy of a warning if a cluster's messages cross the network without TLS."""
    if address is None or address.startswith(("tls://", "wss://", "inproc://")):
        return None
    host = urlsplit(address if "://" in address else f"tcp://{address}").hostname or ""
    if host in _THIS_MACHINE:
        return None
    place = address.partition("://")[2] or address
    return (
        "cluster-unprotected",
        f"The cluster at '{address}' is used without TLS: whoever reaches its network can run code here.",
        f"Use --cluster tls://{place}, with certificates in Dask's configuration (docs/cluster.md).",
    )


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    distributed = optional("cluster", "A cluster")
    import dask

    # The room and its cache are far larger than a task's usual arguments.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
        # A client that can't connect must never be made: its __del__ may wait forever for a lock of
        # `distributed` that is held by the very thread on which the garbage collection runs.
        if (reason := _why_no_answer(address)) is not None:
            raise _unreachable(address, reason)
        try:
            client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except Exception as error:  # it answered a moment ago, but is gone now
            raise _unreachable(address, str(error)) from None
        try:
            yield client
        finally:
            client.close(timeout=CONNECT_SECONDS)


def _unreachable(address: str, reason: str) -> FiptError:
    return FiptError("cluster-unreachable", address=address, reason=reason)


def _why_no_answer(address: str) -> str | None:
    """Why no scheduler answers at an address within `CONNECT_SECONDS`; None if one does."""
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
        except Exception as error:  # each transport has its own exceptions
            reasons[0] = str(error) or type(error).__name__

    reasons: list[str | None] = [f"no answer within {CONNECT_SECONDS:.0f} seconds"]
    # Looking up a host name can't be interrupted and may take minutes, hence a daemon thread.
    thread = threading.Thread(target=run, name="fipt-scheduler", daemon=True)
    thread.start()
    # The transport's own error comes first: it says more than ours.
    thread.join(CONNECT_SECONDS + 1.0)
    return reasons[0]


class ClusterWorkers:
    """Does the work of views on a cluster; see :class:`per_view.Workers`.

    If a worker is lost, other workers do its views, with the same results.
    """

    def __init__(self, client: Client) -> None:
        import mitsuba

        device = next(name for name, variant in VARIANTS.items() if variant == mitsuba.variant())
        self._client = client
        self._needs = Needs(PRODUCT_VERSION, method_digest(), device, package_versions(_PACKAGES))

    def map(self, work: ViewWork[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result]]:
        """See :class:`per_view.Workers`.

        Raises:
            FiptError: see :func:`workers_at`; or the error that a worker raised.
        """
        from distributed.protocol import serialize_bytes

        self._check_imports()
        packed = serialize_bytes(work)
        stage_key = hashlib.sha256(packed).hexdigest()
        name = f"fipt-{uuid.uuid4().hex}"  # keys must differ from those of other clients and of earlier work
        stage = self._client.submit(_keep, packed, key=f"{name}-stage")
        del packed
        remaining = enumerate(items)
        pending: dict[Future, int] = {}
        try:
            while True:
                # Two views for each worker, so that none waits for its next one.
                free = max(0, 2 * max(1, self._count()) - len(pending))
                for index, item in islice(remaining, free):
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
        """Check that all workers can import the engine; else they would die silently at their first view.

        Raises:
            FiptError: ``cluster-worker-unfit``.
        """
        with _scheduler_errors():
            results = self._client.run(importlib.import_module, __name__, on_error="return")
        for address, result in results.items():
            if isinstance(result, ImportError):
                raise _unfit(f"The worker at {address}", result) from result

    def _count(self) -> int:
        """Number of connected workers."""
        with _scheduler_errors():
            return len(self._client.nthreads())

    def _wait(self, futures: list[Future]) -> list[Future]:
        """Wait until at least one of the futures has ended; returns those that have."""
        from distributed import wait

        last_worker = time.monotonic()
        while True:
            with _scheduler_errors(), self._client.as_current():
                try:
                    return list(wait(futures, timeout=POLL_SECONDS, return_when="FIRST_COMPLETED").done)
                except TimeoutError:
                    pass
            if self._count():
                last_worker = time.monotonic()
            if time.monotonic() - last_worker > WORKERS_SECONDS:
                raise FiptError("cluster-no-worker", workers_seconds=WORKERS_SECONDS)


@contextmanager
def _scheduler_errors() -> Iterator[None]:
    """Turn the loss of the scheduler into the error ``cluster-lost``."""
    from distributed import CancelledError

    try:
        yield
    except (CancelledError, OSError) as error:
        raise FiptError("cluster-lost.scheduler-errors", kind=type(error).__name__, error=error) from error


def _result(future: Future) -> Any:
    """The result of a worker.

    Raises:
        FiptError: ``cluster-worker-unfit``, ``cluster-lost``, or the error that the worker raised.
    """
    from distributed import CancelledError
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise FiptError("cluster-lost.result", error=error) from error
    except CancelledError as error:
        raise FiptError("cluster-lost.result-2", error=error) from error
    except (ImportError, AttributeError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "deserializ" not in str(error):
            raise  # an error of the work itself
        raise _unfit("The cluster", error) from error


def _unfit(subject: str, error: Exception) -> FiptError:
    return FiptError(
        "cluster-worker-unfit.unfit",
        subject=subject,
        kind=type(error).__name__,
        error=" ".join(str(error).split()),
    )


# Functions that run in the workers


def _keep(packed: bytes) -> bytes:
    """Make a stage's work a result of the cluster: each worker fetches it once, also from other workers."""
    return packed


def _work_on(needs: Needs, stage_key: str, stage: bytes, item: bytes) -> Any:
    """Do the work of one view in a worker."""
    from distributed.protocol import deserialize_bytes

    global _stage
    with _lock:
        _check(needs)
        if _stage is None or _stage[0] != stage_key:
            _stage = None  # frees the memory of the previous stage first
            _stage = stage_key, deserialize_bytes(stage).prepare()
        return _stage[1](deserialize_bytes(item))


def _check(needs: Needs) -> None:
    """Check that this worker fits the run, and choose Mitsuba's variant.

    Raises:
        FiptError: ``cluster-worker-unfit``.
    """
    here = Needs(PRODUCT_VERSION, method_digest(), needs.device, package_versions(_PACKAGES))
    reason = "" if here == needs else f"it has {_text(here)}, but the run has {_text(needs)}"
    try:
        if not reason:
            set_variant(needs.device)
    except (FiptError, ImportError, RuntimeError) as error:
        reason = error.text if isinstance(error, FiptError) else str(error)
    if reason:
        raise FiptError("cluster-worker-unfit.check", node=platform.node(), reason=reason)


def _text(needs: Needs) -> str:
    product = f"fipt_blender {needs.product} (source {needs.method})"
    return ", ".join([product, *(f"{name} {version}" for name, version in needs.packages.items())])
