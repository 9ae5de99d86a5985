"""Files are written whole or not at all, and read without waiting."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from frenetic._support.files import read_bounded, replacing, write_file
from frenetic._support.onnx_model import read_model
from frenetic.campaign.lock import holder, last_host
from frenetic.errors import CampaignError, FreneticError
from frenetic.road.files import read_road
from frenetic.spec import Spec


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[Path]:
    """A named pipe without content; code that opens it does not wait forever."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    writer = threading.Thread(target=lambda: path.open("wb").close())
    writer.start()
    yield path
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    writer.join()
    os.close(reader)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("read", [read_bounded, read_road, read_model, Spec.read])
def test_a_pipe_in_place_of_a_file_is_refused(read: Callable[[Any], object], pipe: Path) -> None:
    with pytest.raises((FreneticError, ValueError), match="it is a pipe or a device"):
        read(pipe)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_pipe_in_place_of_a_lock_has_no_holder(pipe: Path) -> None:
    assert holder(pipe) is last_host(pipe) is None


@pytest.mark.skipif(not Path("/dev/fd").is_dir(), reason="a shell's pipes have no names here")
def test_a_pipe_of_the_shell_is_read() -> None:
    reader, writer = os.pipe()
    os.write(writer, b"content")
    os.close(writer)
    assert read_bounded(Path(f"/dev/fd/{reader}")) == b"content"
    os.close(reader)


@pytest.mark.parametrize("durable", [False, True])
@pytest.mark.parametrize("content", ["κ\r\n1\n", "κ\r\n1\n".encode()])
def test_a_file_replaces_an_existing_one(
    tmp_path: Path, content: str | bytes, durable: bool
) -> None:
    path = tmp_path / "a.csv"
    path.write_text("before")
    write_file(path, content, remedy="go elsewhere", durable=durable)
    assert path.read_bytes() == "κ\r\n1\n".encode()
    assert list(tmp_path.iterdir()) == [path]


def test_the_error_of_a_file_that_cannot_be_written_names_cause_and_remedy(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "a.csv"
    with pytest.raises(FreneticError) as caught:
        write_file(path, "1", remedy="go elsewhere")
    assert str(caught.value) == (
        f"{path} cannot be written: No such file or directory; go elsewhere"
    )
    with pytest.raises(CampaignError):
        write_file(path, "1", remedy="go elsewhere", error=CampaignError)


@pytest.mark.parametrize("error", [OSError(28, "full"), KeyboardInterrupt()])
def test_the_old_file_stays_if_writing_is_stopped(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.csv"
    path.write_text("before")

    def stop() -> None:
        with replacing(path) as partial:
            partial.write_text("half of")
            raise error

    with pytest.raises(type(error)):
        stop()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
    (tmp_path / "b").mkdir()
    with pytest.raises(OSError, match="directory"), replacing(tmp_path / "b") as partial:
        partial.write_text("whole")
    assert sorted(tmp_path.iterdir()) == [path, tmp_path / "b"]
