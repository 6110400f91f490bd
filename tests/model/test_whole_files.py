"""Files that are there whole or not at all: several writers, leftovers, refusals."""

import os
import stat
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from jaxstage.system import files
from jaxstage.system.files import write_text, write_whole


@pytest.mark.fast
def test_two_writers_of_one_file_do_not_meet(tmp_path):
    file = tmp_path / "sweep.toml"
    texts = [bytes([65 + i]) * 10_000 for i in range(4)]

    def write(text):
        for _ in range(25):
            write_whole(file, text)

    with ThreadPoolExecutor(len(texts)) as pool:
        for done in [pool.submit(write, text) for text in texts]:
            done.result()
    assert file.read_bytes() in texts
    assert [x.name for x in tmp_path.iterdir()] == [file.name]


@pytest.mark.fast
def test_what_a_killed_writer_left_is_removed(tmp_path):
    file = tmp_path / "a[1].json"
    old, young, other = (
        tmp_path / f".{name}.partial" for name in ("a[1].json.1", "a[1].json.2", "a1.json.3")
    )
    past = time.time() - files.ABANDONED - 1
    for partial in (old, young, other):
        partial.write_text("half", encoding="utf-8")
    for partial in (old, other):
        os.utime(partial, (past, past))
    write_text(file, "{}")
    assert sorted(tmp_path.iterdir()) == sorted([file, young, other])


@pytest.mark.fast
def test_a_file_that_cannot_be_written_is_as_it_was(tmp_path, monkeypatch):
    file = tmp_path / "kept"
    file.write_text("before", encoding="utf-8")
    monkeypatch.setattr(files.os, "replace", lambda *a: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(OSError, match="full") as refused:
        write_text(file, "after")
    assert refused.value.filename == str(file)
    assert file.read_text(encoding="utf-8") == "before"
    assert [x.name for x in tmp_path.iterdir()] == [file.name]


@pytest.mark.fast
def test_a_file_has_the_mode_that_the_user_chose(tmp_path):
    mask = os.umask(0o027)
    try:
        write_text(tmp_path / "file", "text")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o640
