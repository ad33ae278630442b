"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import stat

import pytest

from questsim.errors import InputError
from questsim.files import whole_file


def test_a_file_appears_when_it_is_whole_and_others_may_read_it(tmp_path):
    path = tmp_path / "a.txt"
    with whole_file(path) as fresh:
        fresh.write_text("new")
        assert fresh.suffix == ".txt" and not path.exists()
    assert os.listdir(tmp_path) == ["a.txt"] and path.read_text() == "new"
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_the_old_file_stays_if_writing_fails(error, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(error), whole_file(path) as fresh:
        fresh.write_text("ne")
        raise error
    assert os.listdir(tmp_path) == ["a.txt"] and path.read_text() == "old"


def test_a_folder_that_is_none_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in ("none", "file"):
        with (
            pytest.raises(InputError, match=r"a\.txt: cannot be written"),
            whole_file(tmp_path / folder / "a.txt"),
        ):
            pass
