"""Files are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from frenetic._support.files import replacing, write_file
from frenetic.errors import CampaignError, FreneticError


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
