# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checking downloaded files against pinned hashes, before anything of them runs or is unpacked.

pip checks the hashes of the locked packages, but can't vouch for itself: its own wheel, and files that are
not installed (LLVM's wheel), are checked here. Standard library only.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Sequence
from pathlib import Path

from ..core.run.errors import FiptError
from . import pins
from .child import output_end, run_quietly
from .pip import Teller
from .plan import Plan


def pinned_digests(requirements: Sequence[str]) -> set[str]:
    """All SHA-256 that the options ``--hash`` of locked requirements name, in hexadecimal."""
    return {digest for each in requirements for digest in re.findall(r"--hash=sha256:([0-9a-f]{64})\b", each)}


def check_file(path: Path, digests: Collection[str]) -> None:
    """Refuse a file whose SHA-256 is not among the pinned ones.

    Args:
        path: of the file.
        digests: the SHA-256 that are allowed, in hexadecimal.

    Raises:
        FiptError: ``package-hash``.
    """
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest not in digests:
        raise FiptError(
            "package-hash",
            f"{path.name} is not the file that this version was made with.",
            "Do not use the package index or the folder that it came from; if you trust them, ask their owner"
            " why the file was changed.",
        )


def download_checked(plan: Plan, requirements: Sequence[str], folder: Path, tell: Teller) -> list[Path]:
    """Download the wheels of locked requirements, without what they need, and check their hashes.

    Args:
        plan: whose pip downloads, from the network or from the plan's folder of wheels.
        requirements: with hashes (`pins.read_pins`); what has none is not downloaded.
        folder: for the wheels, empty.
        tell: gets the reason in its log if pip fails.

    Returns:
        The checked wheels; none if they can't be had, or if no requirement is meant for this platform.

    Raises:
        FiptError: ``package-hash``.
    """
    names = [pins.without_hashes(each) for each in requirements if pinned_digests([each])]
    if not names:
        return []
    source = ["--no-index", "--find-links", str(plan.wheels)] if plan.wheels else []
    options = ["--no-deps", "--no-input", "--only-binary", ":all:", "--disable-pip-version-check"]
    pip = [str(plan.python), "-I", "-X", "utf8", "-m", "pip", "download", "--quiet", "--dest", str(folder)]
    result = run_quietly([*pip, *options, *source, *names], plan.python)
    if result.returncode != 0:
        tell.log(f"pip download {' '.join(names)}: {output_end(result)}")
        return []
    wheels = sorted(folder.glob("*.whl"))
    for wheel in wheels:
        check_file(wheel, pinned_digests(requirements))
    return wheels
