"""Finding an LLVM with which Mitsuba's CPU variants work. Each candidate is tried in a process of its own.

Dr.Jit takes the first libLLVM that the loader finds, and many of them abort the process (LLVM 14 to 16 on
CPUs with AVX-512). Verdicts are cached, so that only the first start on a machine takes the time of a trial.
Standard library only; Mitsuba is never imported in this process.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..run.documents import optional_document
from ..run.errors import FiptError
from ..run.made import file_state
from ..run.runfolder import write_json
from . import probe

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
PROBE_SECONDS = 180.0  # for compiling a kernel
GOOD_VERSIONS = range(17, 24)  # older ones abort on common CPUs, newer ones are untested: last resorts


@dataclass(frozen=True)
class Verdict:
    """Outcome of a trial: whether the variant works, the reason if not, and whether to cache the verdict."""

    works: bool
    reason: str
    lasting: bool = True


def cache_folder() -> Path:
    """The user's cache folder: $FIPT_CACHE, or the platform's."""
    if named := os.environ.get("FIPT_CACHE"):
        return Path(named)
    home = Path(os.path.expanduser("~"))  # Path.home() raises an error if there is none
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return base / "fipt_blender"


def system_patterns() -> Iterator[tuple[Path, str]]:
    """Where LLVM is usually installed, as (folder, glob pattern)."""
    if sys.platform == "win32":
        for variable in ("ProgramFiles", "ProgramW6432", "LOCALAPPDATA"):
            if base := os.environ.get(variable):
                yield Path(base), "LLVM*/bin/LLVM-C.dll"
                yield Path(base) / "Programs", "LLVM*/bin/LLVM-C.dll"
    elif sys.platform == "darwin":
        for base in ("/opt/homebrew/opt", "/usr/local/opt"):
            yield Path(base), "llvm*/lib/libLLVM*.dylib"
        yield Path("/opt/local/libexec"), "llvm-*/lib/libLLVM*.dylib"
    else:
        for base in ("/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/local/lib64"):
            yield Path(base), "libLLVM*.so*"
        yield Path("/usr/lib"), "*-linux-gnu*/libLLVM*.so*"
        yield Path("/usr/lib"), "llvm-*/lib/libLLVM*.so*"
        yield Path("/usr/lib"), "llvm*/lib64/libLLVM*.so*"
        yield Path("/usr/lib64"), "llvm*/lib*/libLLVM*.so*"


def library_version(library: Path) -> int:
    """Major version of an LLVM library according to its name or its folder; 0 if neither contains it."""
    name = re.search(r"(?:libLLVM|LLVM-C)[-.](?:so\.)?(\d+)", library.name)
    folder = re.search(r"llvm(?:@|-)?(?:[/\\])?(\d+)", str(library.parent), re.IGNORECASE)
    match = name or folder
    return int(match.group(1)) if match else 0


def order_candidates(libraries: Sequence[Path]) -> list[Path]:
    """Sort libraries: first good versions, newest first, then newer and unknown versions, then older ones.

    Links to the same file are listed once.
    """

    def rank(library: Path) -> tuple[int, int]:
        version = library_version(library)
        tier = 0 if version in GOOD_VERSIONS else 1 if version == 0 or version > GOOD_VERSIONS[-1] else 2
        return tier, -version

    unique: dict[Path, Path] = {}
    for library in libraries:
        real = library.resolve()
        if real.is_file():
            unique.setdefault(real, real)
    return sorted(unique, key=rank)


def llvm_candidates() -> list[Path]:
    """All LLVM libraries to try, best first.

    The first is the one that the user names in DRJIT_LIBLLVM_PATH; then come those of this environment, in
    its folder "llvm" with the libraries that they need or in "lib", then those of the system.
    """
    preferred: list[Path] = []
    if named := os.environ.get(LLVM_VARIABLE):
        preferred += [path for path in [Path(named)] if path.is_file()]
    names = {"win32": "LLVM-C*.dll", "darwin": "libLLVM*.dylib"}.get(sys.platform, "libLLVM*.so*")
    in_environment: list[Path] = []
    for folder in ("llvm", "lib"):
        in_environment += Path(sys.prefix, folder).glob(names)
    preferred += order_candidates(in_environment)
    system = [path for base, pattern in system_patterns() for path in base.glob(pattern)]
    return list(dict.fromkeys([path.resolve() for path in preferred] + order_candidates(system)))


def companions(library: Path) -> list[str]:
    """Libraries to load before an environment's own LLVM: all others in its folder.

    An LLVM of the system needs none, and its folder contains all libraries of the system.
    """
    if library.parent.name != "llvm":
        return []
    return [str(path) for path in sorted(library.parent.iterdir()) if not path.name.startswith("libLLVM")]


def try_variant(variant: str, library: Path | None = None) -> Verdict:
    """Run the workload of :mod:`.probe` in a child process.

    Args:
        variant: ``"llvm_ad_rgb"`` or ``"cuda_ad_rgb"``.
        library: the LLVM to use.

    Raises:
        FiptError: ``package-missing`` if Mitsuba can't be imported.
    """
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    libraries: list[str] = []
    if library is not None:
        environment[LLVM_VARIABLE] = str(library)
        libraries = companions(library)
    paths = [entry for entry in sys.path if Path(entry).is_absolute()]
    command = [sys.executable, "-I", probe.__file__, variant, json.dumps(paths), json.dumps(libraries)]
    with tempfile.TemporaryFile() as log:
        try:
            status = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                timeout=PROBE_SECONDS,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            return Verdict(False, f"no answer within {PROBE_SECONDS:.0f} seconds", lasting=False)
        log.seek(0)
        output = log.read().decode("utf-8", "replace")
    if probe.IMPORTED not in output:
        raise FiptError(
            "package-missing.try-variant",
            executable=sys.executable,
            reason=_reason(output) or f"exit status {status}",
        )
    if status == 0 and probe.PASSED in output:
        return Verdict(True, "")
    if status < 0:
        # SIGKILL comes from outside (out of memory, the user) and says nothing about the library.
        return Verdict(False, f"the process was ended by signal {-status}", lasting=status != -9)
    return Verdict(False, _reason(output) or f"exit status {status}")


def remembered(key: str, trial: Callable[[], Verdict]) -> Verdict:
    """The cached verdict for a key, or else the verdict of the trial, which is then cached.

    A cache that can't be read or written only costs time.
    """
    file = cache_folder() / "devices.json"
    verdicts = optional_document(file, dict[str, Verdict]) or {}
    if key in verdicts:
        return verdicts[key]
    verdict = trial()
    if verdict.lasting:
        verdicts[key] = verdict
        with contextlib.suppress(FiptError):
            write_json(file, verdicts)
    return verdict


def package_key() -> str:
    """Key of what a verdict depends on besides the library: machine, Mitsuba and Dr.Jit."""
    versions = [importlib.metadata.version(name) for name in ("mitsuba", "drjit")]
    return "|".join([platform.node(), platform.machine(), *versions])


def find_llvm() -> Path:
    """The best LLVM that works with Mitsuba.

    Raises:
        FiptError: ``llvm-missing``, which says what to install, or ``package-missing``.
    """
    failures: list[str] = []
    for library in llvm_candidates():
        verdict = remembered(
            f"{package_key()}|{file_state(library)}", partial(try_variant, "llvm_ad_rgb", library)
        )
        if verdict.works:
            return library
        failures.append(f"{library} ({verdict.reason})")
    text = "Mitsuba needs LLVM to compute on the CPU, but none was found on this machine."
    if failures:
        listed = "; ".join(failures)
        text = f"Mitsuba needs LLVM to compute on the CPU, but none on this machine works: {listed}."
    raise FiptError.of("llvm-missing", text, install_remedy())


def install_remedy() -> str:
    """Text on what to install on this platform."""
    if sys.platform == "win32":
        how = "Install LLVM 19 or newer from the LLVM project's releases (its LLVM-C.dll is used)."
    elif sys.platform == "darwin":
        how = "Install LLVM with: brew install llvm"
    else:
        release = _os_release()
        family = f"{release.get('ID', '')} {release.get('ID_LIKE', '')}"
        if "debian" in family or "ubuntu" in family:
            how = "Install LLVM 19 with: apt-get install libllvm19"
        elif any(name in family for name in ("fedora", "rhel", "centos")):
            how = "Install LLVM with: dnf install llvm-libs"
        elif "arch" in family:
            how = "Install LLVM with: pacman -S llvm-libs"
        elif "suse" in family:
            how = "Install LLVM with: zypper install libLLVM19"
        else:
            how = "Install the shared library of LLVM 19 or newer (libLLVM.so)."
    return f"{how} Or set {LLVM_VARIABLE} to one that works."


def _os_release() -> dict[str, str]:
    try:
        return platform.freedesktop_os_release()
    except OSError:
        return {}


def _reason(output: str) -> str:
    """The most helpful line of a failed child's output: the one on a missing library, or else the last."""
    lines = [line.strip() for line in output.splitlines() if line.strip() and line.strip() != probe.IMPORTED]
    missing = [line for line in lines if "cannot open shared object file" in line]
    return (missing or lines or [""])[-1][:200]
