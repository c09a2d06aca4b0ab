"""The check that all writing goes through files.py and folders.py notices what does not."""

import pytest

from writes import main, writes

WRITES = """
open(path, "w"), open(path, mode="ab"), path.open("x"), path.open(mode="r+")
path.write_text(text), path.write_bytes(data), path.touch()
path.unlink(), os.remove(path), path.rmdir(), shutil.rmtree(folder)
path.rename(other), path.replace(other), os.replace(a, b), shutil.move(a, b)
np.save(path, array), torch.save(model, path), figure.savefig(path)
os.open(path, os.O_RDWR), tempfile.mkdtemp()
"""
READS = """
open(path), open(path, "rb"), path.open(), path.read_text()
text.replace("w", "x"), replace(cfg, out=out), date.replace(year=1), np.load(path)
figure.savefig(buffer, format="png"), os.open(os.devnull, os.O_WRONLY), os.open(path, os.O_RDONLY)
"""


@pytest.mark.parametrize(("code", "count"), [(WRITES, 20), (READS, 0)])
def test_calls_that_write_are_told_from_those_that_do_not(code, count):
    assert len(list(writes(code))) == count


def test_nothing_else_in_src_writes(capsys):
    assert main() == 0, capsys.readouterr().out
