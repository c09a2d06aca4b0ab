"""The leaderboard: order, intervals, and names that strangers chose."""

import html
import json
import re

import pytest
from markdown_it import MarkdownIt

from renet.errors import RenetError
from renet.evaluation.benchmark import leaderboard

from .rows import result

GOOD = [2] * 18 + [1, 1]
BAD = [1] * 20


def write(path, content):
    path.write_text(json.dumps(content, default=float))
    return path


def test_the_best_comes_first_and_leads_are_of_the_first_file():
    title, header, rows = leaderboard.ranking([result(BAD, "worse"), result(GOOD, "better")])
    assert [line[1] for line in rows] == ["better", "worse"]
    assert rows[1][header.index("behind it")] == "-"
    assert rows[0][header.index("behind it")].startswith("-45.0 (")
    assert "it: worse, memory" in title


def test_equal_differences_have_no_interval():
    _, header, rows = leaderboard.ranking([result(GOOD, "ours"), result(GOOD, "same")])
    assert rows[1][header.index("behind it")] == "+0.0 (all alike)"
    half = leaderboard.ranking([result(BAD)])[2][0]
    assert half[header.index("95 %")] == "all alike"


def test_counts_are_of_obstacles_and_of_episodes():
    _, header, rows = leaderboard.counts(result([2] * 9 + [1]))
    cells = dict(zip(header[:4], rows[0][:4], strict=True))
    # Clopper and Pearson's interval of 9 in 10, from their table.
    assert cells == {
        "entry": "memory",
        "obstacles crossed": "19 of 20",
        "courses crossed": "9 of 10",
        "95 %": "55.5 to 99.7",
    }
    assert rows[0][4:] == ("1 of 10", "0.3 to 44.5")


def test_the_measures_say_of_how_many_episodes_they_are():
    title = leaderboard.measures([result(GOOD)])[0]
    assert title == "Measures: 10 episodes with loud faults, 10 with lies, 4 of strangers"


def test_three_trainings_of_a_method_are_one_line():
    trainings = [result(crossed, f"t{i}", "ours") for i, crossed in enumerate((GOOD, BAD, GOOD))]
    _, header, rows = leaderboard.ranking(trainings)
    assert len(rows) == 1
    assert rows[0][header.index("over")] == "3 trainings"
    assert float(rows[0][header.index("score")]) == pytest.approx((95 + 50 + 95) / 3, abs=0.05)


def test_two_trainings_do_not_count_every_episode_twice():
    """A second training with the same walks leaves the interval over episodes as it is."""
    _, header, alone = leaderboard.ranking([result(GOOD)])
    twins = [result(GOOD, "t1", "ours"), result(GOOD, "t2", "ours")]
    _, _, rows = leaderboard.ranking(twins)
    interval = header.index("95 %")
    assert rows[0][interval] == alone[0][interval]
    assert rows[0][header.index("over")] == "episodes"


def test_a_policy_is_one_training_however_often_it_is_given():
    copies = [result(GOOD, "first", "ours"), result(BAD, "second", "ours")]
    with pytest.raises(RenetError, match=r"ours, memory, are of one policy, first [0-9a-f]{12}:"):
        leaderboard.ranking([*copies, copies[0]])
    # Its entries may lie in several files.
    others = [result(GOOD, "first", "ours", entry) for entry in ("memory", "switch")]
    assert len(leaderboard.ranking(others)[2]) == 2


def test_different_episodes_are_not_compared():
    with pytest.raises(RenetError, match="results of the same episodes"):
        leaderboard.ranking([result(GOOD), result([2] * 200, "other", episodes="full")])


HOSTILE = (
    "[x](javascript:1)|<script>alert(1)</script>`a`*b*~~c~~&lt;https://x.y\n# top\r\x1b[31m\u202e"
)
"""A link, a cell's end, HTML, code, emphasis, an entity, an address, lines, colour, direction."""


def test_names_from_files_are_text(tmp_path, capsys):
    content = result(GOOD, HOSTILE, entry=HOSTILE[:60])
    content["policy"]["robot"] = HOSTILE
    for row in content["rows"]:
        row["family"] = HOSTILE
    file = write(tmp_path / "a.json", content)
    out = leaderboard.make_leaderboard(leaderboard.LeaderboardCfg((file,), tmp_path / "out.md"))
    shown = capsys.readouterr().out
    text = out.read_text()
    for control in ("\x1b", "\r", "\u202e"):
        assert control not in shown
        assert control not in text
    # Sites make a link of a bare address.
    assert "://" not in text
    # As a site shows the Markdown: as many cells as ever, and every name as it was written.
    page = MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(text)
    assert not re.findall(r"<(?!/?(?:h2|table|thead|tbody|tr|th|td)\b)", page)
    widths = {len(re.findall("<t[hd]", line)) for line in page.split("<tr>")[1:4:2]}
    plain = html.unescape(page)
    assert widths == {8, 9}
    name = HOSTILE.translate(dict.fromkeys(map(ord, "\n\r\x1b\u202e"), "\ufffd"))
    for place in (f"<td>{name}</td>", f"it: {name}, {name[:60]}"):
        assert place in plain


def test_every_line_of_the_markdown_has_all_cells(tmp_path):
    file = write(tmp_path / "a.json", result(GOOD))
    out = leaderboard.make_leaderboard(leaderboard.LeaderboardCfg((file,), tmp_path / "out.md"))
    head, rule, first = out.read_text().splitlines()[2:5]
    assert head.count("|") == rule.count("|") == first.count("|")


def test_names_are_whole_in_a_terminal_of_80_columns(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    files = []
    for name, entry in (("go1-parkour", "oracle, handing over"), ("robot-lab", "blind")):
        content = result(GOOD, name, entry=entry)
        content["policy"]["robot"] = "Unitree Go1"
        files.append(write(tmp_path / f"{name}.json", content))
    leaderboard.make_leaderboard(leaderboard.LeaderboardCfg((*files,), tmp_path / "out.md"))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    words = shown.split()
    # In the ranking and the measures.
    for word in ("go1-parkour", "robot-lab", "handing", "stranger"):
        assert word in words
    assert words.count("robot-lab") == 2


def test_no_file_is_told():
    with pytest.raises(RenetError, match="give result files"):
        leaderboard.make_leaderboard(leaderboard.LeaderboardCfg(()))
