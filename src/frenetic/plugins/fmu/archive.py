"""The file of an FMU, a zip: it is checked before anything of it is unpacked."""

from __future__ import annotations

import hashlib
import stat
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Final
from zipfile import BadZipFile, ZipFile, ZipInfo

from frenetic._support.files import open_file
from frenetic.plugins.fmu.folders import private_folder

DESCRIPTION: Final = "modelDescription.xml"
"""Name of the model description in an FMU."""
_MOST_BYTES: Final = 2**28
"""Largest size of a file, in bytes; our choice."""
_MOST_UNPACKED: Final = 2**30
"""Largest size of what is unpacked of a file, in bytes; our choice."""
_MOST_DESCRIPTION: Final = 2**26
"""Largest size of a model description, in bytes; our choice."""
_MOST_MEMBERS: Final = 20_000
"""Largest number of files in an FMU; our choice."""
_CHUNK: Final = 2**20
"""Number of bytes that are read at once; our choice."""
_ENCRYPTED: Final = 1
"""Flag of an encrypted member of a zip."""


class FmuArchive:
    """The file of an FMU.

    Args:
        content: the file's bytes.

    Raises:
        ValueError: the bytes are no zip, or a damaged, encrypted or too large one; a member lies
            outside the folder into which it would be unpacked; or there is no model description.
    """

    def __init__(self, content: bytes) -> None:
        self.content = content
        try:
            with ZipFile(BytesIO(content)) as archive:
                self._members = archive.infolist()
        except (BadZipFile, ValueError, OSError, NotImplementedError) as error:
            raise ValueError(f"it is no FMU: it is no zip that can be read ({error})") from None
        if len(self._members) > _MOST_MEMBERS:
            raise ValueError(f"it holds more than {_MOST_MEMBERS} files")
        for member in self._members:
            _check_member(member)
        self.names = frozenset(member.filename for member in self._members)
        """Names of the members, with slashes."""
        if len(self.names) < len(self._members):
            raise ValueError("it is damaged: it holds two files of one name")
        if DESCRIPTION not in self.names:
            raise ValueError(f"it is no FMU: it holds no {DESCRIPTION}")
        self.digest = hashlib.sha256(content).hexdigest()
        """SHA-256 of the file."""

    @property
    def description(self) -> bytes:
        """Bytes of the model description.

        Raises:
            ValueError: it is damaged or too large.
        """
        (member,) = (member for member in self._members if member.filename == DESCRIPTION)
        if member.file_size > _MOST_DESCRIPTION:
            raise ValueError(f"its {DESCRIPTION} has {member.file_size} bytes: too many")
        return b"".join(self._chunks(member))

    def description_alone(self) -> BytesIO:
        """Return a zip that holds the model description and nothing else.

        Raises:
            ValueError: it is damaged or too large.
        """
        file = BytesIO()
        with ZipFile(file, "w") as archive:
            archive.writestr(DESCRIPTION, self.description)
        return file

    def check_contents(self, folder: str) -> None:
        """Check the members that `unpacked` unpacks, by their sizes and checksums.

        Args:
            folder: folder of the binaries, such as ``binaries/linux64``.

        Raises:
            ValueError: a member is damaged, or they are too large.
        """
        members = self._needed(folder)
        size = sum(member.file_size for member in members)
        if size > _MOST_UNPACKED:
            raise ValueError(
                f"it is too large: {size / 2**20:.0f} MiB unpacked, at most"
                f" {_MOST_UNPACKED / 2**20:.0f} MiB are allowed"
            )
        for member in members:
            for _ in self._chunks(member):
                pass

    def unpacked(self, folder: str) -> Path:
        """Return a folder with this machine's binaries and the resources, unpacked once a process.

        Args:
            folder: folder of the binaries, such as ``binaries/linux64``.

        Raises:
            ValueError: a member is damaged.
            OSError: a file cannot be written.
        """

        def fill(place: Path) -> None:
            for member in self._needed(folder):
                target = place.joinpath(*PurePosixPath(member.filename).parts)
                target.parent.mkdir(parents=True, exist_ok=True)
                with target.open("wb") as file:
                    file.writelines(self._chunks(member))
            (place / "resources").mkdir(exist_ok=True)  # FMUs get its path, with files or without

        return private_folder(self.digest, fill)

    def _chunks(self, member: ZipInfo) -> Iterator[bytes]:
        """Yield the bytes of a member in pieces.

        Raises:
            ValueError: the member is damaged.
        """
        try:
            with ZipFile(BytesIO(self.content)) as archive, archive.open(member) as file:
                while chunk := file.read(_CHUNK):
                    yield chunk
        except (
            BadZipFile,
            zlib.error,
            EOFError,
            OSError,
            ValueError,
            NotImplementedError,
        ) as error:
            name = member.filename[:80]
            raise ValueError(f"it is damaged: {name!r}: {error}") from None

    def _needed(self, folder: str) -> list[ZipInfo]:
        """Return the members that an FMU needs to run on this machine."""
        folders = (f"{folder}/", "resources/")
        return [
            member
            for member in self._members
            if member.filename.startswith(folders) and not member.is_dir()
        ]


def read_archive(path: str) -> FmuArchive:
    """Read the file of an FMU.

    Raises:
        ValueError: the file is missing, cannot be read, is too large, or is no FMU.
    """
    try:
        with open_file(Path(path).expanduser()) as file:
            content = file.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        raise ValueError(f"there is no file {path!r}") from None
    except OSError as error:
        raise ValueError(f"it cannot be read: {error.strerror or error}") from None
    if len(content) > _MOST_BYTES:
        raise ValueError(f"it is too large: more than {_MOST_BYTES / 2**20:.0f} MiB")
    return FmuArchive(content)


def _check_member(member: ZipInfo) -> None:
    """Check that a member of a zip is a plain file within the folder of the FMU.

    Raises:
        ValueError: the member is a link or encrypted, or lies elsewhere.
    """
    name = member.orig_filename
    parts = name.split("/")
    if name.startswith("/") or ".." in parts or any(sign in name for sign in "\\:\0"):
        raise ValueError(f"it is no FMU: it names the path {name[:80]!r}, outside its folder")
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise ValueError(f"it is no FMU: {name[:80]!r} is a link, where a file is needed")
    if member.flag_bits & _ENCRYPTED:
        raise ValueError(f"it is encrypted: {name[:80]!r}")
