"""Films beside a training: when they begin, one at a time, and what a failure costs (nothing)."""

import math
import sys
from pathlib import Path

import pytest

from renet.training import films
from renet.training.films import Films, filming


class Recorded(Films):
    """Films by a program of the test's own."""

    program = "import pathlib, sys; pathlib.Path(sys.argv[2]).write_text(sys.argv[1])"

    def command(self, checkpoint: Path, film: Path):
        film.parent.mkdir(exist_ok=True)
        return [sys.executable, "-c", self.program, str(checkpoint), str(film)]


def save(run: Path, iteration: int) -> None:
    folder = run / "checkpoints" / f"it_{iteration:08}"
    folder.mkdir(parents=True)
    (folder / "state.json").write_text("{}")


@pytest.fixture
def said() -> list[str]:
    return []


def test_the_program_that_has_the_task_films_it(tmp_path, monkeypatch):
    monkeypatch.setattr(films, "own_program", lambda: ["python", "add_robot.py"])
    line = Films(tmp_path, 50, True, print).command(tmp_path / "it_00000050", tmp_path / "a.mp4")
    assert list(line)[:4] == ["nice", "python", "add_robot.py", "play"]


def test_each_round_of_iterations_has_one_film(tmp_path, said):
    save(tmp_path, 60)
    films = Recorded(tmp_path, 50, True, said.append)
    for iteration in (60, 80, 110, 120, 170):
        if iteration > 60:
            save(tmp_path, iteration)
        films.update()
        films.close()
    names = sorted(path.name for path in (tmp_path / "films").iterdir())
    assert names == ["it_00000110.mp4", "it_00000170.mp4"]
    assert said == [f"Film: {tmp_path / 'films' / name}" for name in names]
    assert "it_00000110" in (tmp_path / "films" / names[0]).read_text()


def test_a_film_that_fails_is_told_and_training_goes_on(tmp_path, said):
    films = Recorded(tmp_path, 10, True, said.append)
    films.program = "import sys; sys.exit('no ffmpeg here')"
    with filming(films, math.inf, []) as film:
        film()
        save(tmp_path, 10)
    assert said == ["No film it_00000010.mp4: no ffmpeg here"]


def test_a_film_that_cannot_begin_is_told_and_the_next_one_begins(tmp_path, said):
    films = Recorded(tmp_path, 10, True, said.append)
    films.command = lambda checkpoint, film: ["/nowhere/nice"]  # type: ignore[method-assign]
    save(tmp_path, 10)
    films.update()
    assert said == ["No film it_00000010.mp4: No such file or directory"]
    del films.command
    save(tmp_path, 20)
    films.update()
    films.close()
    assert said[1:] == [f"Film: {tmp_path / 'films' / 'it_00000020.mp4'}"]


def test_a_stopped_run_does_not_wait(tmp_path, said):
    save(tmp_path, 10)
    films = Recorded(tmp_path, 10, True, said.append)
    films.program = "import time; time.sleep(1000)"
    films.update()
    assert films._process is None, "what a run goes on from is not filmed"
    save(tmp_path, 20)
    with filming(films, math.inf, [2]) as film:
        film()
        process = films._process
    assert process.returncode == -9
    assert said == []


def test_nobody_who_wants_no_film_pays_for_one():
    with filming(None, math.inf, []) as film:
        assert film() is None


@pytest.mark.parametrize(("tiles", "ground"), [(True, "gap"), (False, "flat")])
def test_films_are_of_renet_play_on_the_tasks_ground(tmp_path, said, tiles, ground):
    from renet.cli import parse
    from renet.evaluation.play import PlayCfg

    command = Films(tmp_path, 1, tiles, said.append).command(Path("it_1"), Path("a.mp4"))
    cfg = parse(PlayCfg, [*command][5:], "renet play")
    assert [*command][2:5] == ["-m", "renet", "play"]
    assert (cfg.bundle, cfg.out, cfg.terrain) == (Path("it_1"), Path("a.mp4"), ground)
    assert (cfg.fault, cfg.modes, cfg.viewer) == ((), ("camera", "blind"), "none")
