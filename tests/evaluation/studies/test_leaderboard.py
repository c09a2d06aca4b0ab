"""The leaderboard: who leads, and the tables behind, from files that may be damaged."""

import json
import re

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.studies import leaderboard
from renet.evaluation.studies.benchmark import GROUNDS, ONSETS
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.studies.leaderboard import LeaderboardCfg, make_leaderboard, rank


def share(value: float, change: float = 0.0) -> dict:
    return {"value": value, "ci95": None, "change": {"value": change, "ci95": None}}


def complete(name: str, crossed: float) -> dict:
    """A result of every quick setting in which the same share crosses everywhere."""
    names = ("crossed", "upright", "speed_error", "energy_per_metre", "collisions")
    measures = {n: share(crossed) for n in (*names, "seconds_without_sight", "switches")}
    settings = [
        {"ground": s.ground, "level": GROUNDS[s.ground], "fault": s.fault, "severity": s.severity}
        | {"onset": ONSETS[s.onset], "mode": "camera", "measures": measures}
        for settings in FaultStudy(quick=True).batches.values()
        for s in settings
    ]
    policy = {"name": name, "url": None, "sha256": "0" * 64, "modes": ["camera"]}
    protocol = {"robots": 5, "seed": 1, "speed": 0.6, "lasts": 4.0, "seconds": 10.0, "quick": True}
    origin = dict.fromkeys(("renet", "commit", "command", "date"), "x") | {"engine": "warp"}
    kind = {"benchmark": "renet-faults", "version": 1, "provenance": origin}
    robots = {g: {"crossed": [crossed] * 2, "upright": [1.0, 1.0]} for g in GROUNDS}
    robots["gap"]["crossed"] = [1.0, 0.0]
    parts = {"policy": policy, "protocol": protocol, "settings": settings}
    return kind | parts | {"by_robot": {"camera": robots}}


def test_the_better_policy_leads_and_an_incomplete_one_is_not_ranked():
    poor, good, cheat = complete("poor", 0.4), complete("good", 0.6), complete("cheat", 1.0)
    cheat["settings"] = cheat["settings"][1:]
    easy, lucky = complete("easy", 0.9), complete("lucky", 0.8)
    easy["settings"] = [entry | {"level": 1} for entry in easy["settings"]]
    lucky["protocol"]["seed"] = 77
    rows = rank([poor, cheat, good, lucky, easy])
    assert [row[:4] for row in rows] == [
        ("1", "good", "camera", "60.0 %"),
        ("2", "poor", "camera", "40.0 %"),
        ("incomplete", "cheat", "camera", "100.0 %"),
        ("incomplete", "easy", "camera", "90.0 %"),
        ("incomplete", "lucky", "camera", "80.0 %"),
    ]
    # Two robots that differ on gaps alone: the mean of both, or twice the one or the other.
    weight = np.mean([s["ground"] == "gap" for s in good["settings"] if s["ground"] != "flat"])
    assert rows[0][4] == f"{60 * (1 - weight):.1f} to {60 + 40 * weight:.1f}"
    del good["by_robot"]
    assert rank([good])[0][4] == "-"
    with pytest.raises(RenetError, match="one protocol"):
        rank([poor, good | {"protocol": good["protocol"] | {"quick": False}}])


def test_the_leaderboard_is_made_from_files(tmp_path, capsys):
    files = tmp_path / "one.json", tmp_path / "two.json"
    for file, crossed in zip(files, (0.5, 0.7), strict=True):
        file.write_text(json.dumps(complete(file.stem, crossed)))
    table = make_leaderboard(LeaderboardCfg(files, tmp_path / "new" / "board.md"))
    ranking = table.read_text().split("\n\n")[1].splitlines()
    assert [line.split(" | ")[1] for line in ranking[2:]] == ["two", "one"]
    assert "two" in capsys.readouterr().out
    files[0].write_text('{"benchmark": "renet-faults", "version": 3}')
    with pytest.raises(RenetError, match="no result of renet-faults, version 1 or 2"):
        make_leaderboard(LeaderboardCfg(files, table))


def test_a_strangers_name_is_text_in_a_table(tmp_path):
    """It adds no row, no column, no HTML, no link and no code."""
    name = "a | 1 | <img src=x onerror=alert()>\n| 1 | [x](javascript:1) `b` \\|"
    file = tmp_path / "one.json"
    file.write_text(json.dumps(complete(name, 0.5)))
    text = make_leaderboard(LeaderboardCfg((file,), tmp_path / "board.md")).read_text()
    rows = text.split("\n\n")[1].splitlines()
    assert len(rows) == 3
    separators = [len(re.findall(r"(?<!\\)(?:\\\\)*\|", row)) for row in rows]
    assert len(set(separators)) == 1
    assert not re.search(r"(?<!\\)[<>`]", text)
    assert "](" not in text


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: r["settings"][3].pop("onset"), r"settings\[3\]: 'onset' is a required"),
        (lambda r: r["settings"][3].update(severity=6), "severity: 6 is greater than"),
        (lambda r: r["settings"][3]["measures"].pop("switches"), "'switches' is a required"),
        (lambda r: r["settings"][3]["measures"]["crossed"].update(value=1.2), "1.2 is greater"),
        (lambda r: r["settings"][3]["measures"]["crossed"].pop("ci95"), "'ci95' is a required"),
        (lambda r: r["settings"][3]["measures"]["upright"].update(ci95=[0.1]), "upright.ci95: "),
        (lambda r: r["policy"].update(sha256="unknown"), "'unknown' does not match"),
        (lambda r: r.update(settings=[]), "settings: "),
        (lambda r: r.update(settings={"many": "x" * 9000}), "settings: ….*is not of type 'array'"),
    ],
)
def test_a_file_against_the_schema_is_one_line(tmp_path, spoil, message):
    broken, file = json.loads(json.dumps(complete("one", 0.5))), tmp_path / "one.json"
    spoil(broken)
    file.write_text(json.dumps(broken))
    with pytest.raises(RenetError, match=message) as error:
        make_leaderboard(LeaderboardCfg((file,), tmp_path / "board.md"))
    assert len(str(error.value)) < 400
    assert not (tmp_path / "board.md").exists()


def test_a_valid_file_without_its_numbers_is_one_line(tmp_path):
    file, board = tmp_path / "one.json", tmp_path / "board.md"
    result = complete("one", 0.5)
    result["settings"][3]["measures"]["crossed"]["value"] = None
    file.write_text(json.dumps(result))
    make_leaderboard(LeaderboardCfg((file,), board))
    for spoilt in (
        {},
        {"camera": {g: {"crossed": [1.0] * n, "upright": [1.0]} for n, g in enumerate(GROUNDS, 1)}},
    ):
        file.write_text(json.dumps(result | {"by_robot": spoilt}))
        with pytest.raises(RenetError, match="a number is missing, or not one a robot"):
            make_leaderboard(LeaderboardCfg((file,), board))


def setting(ground: str, severity: int, mode: str, crossed: float, change: float) -> dict:
    """A setting in which as many robots stay upright as cross."""
    place = {"ground": ground, "onset": "on_the_way", "fault": "glare", "severity": severity}
    measures = dict.fromkeys(("crossed", "upright"), share(crossed, change))
    return place | {"mode": mode, "measures": measures | {"switches": share(3.0, 2.5)}}


EVERYBODY = {"crossed": [1.0, 1.0], "upright": [1.0, 1.0]}
RESULT = {
    "policy": {"name": "ours", "modes": ["camera", "memory"]},
    "settings": [
        setting("flat", 1, "camera", 1.0, 0.0),
        setting("flat", 1, "memory", 1.0, 0.0),
        setting("gap", 1, "camera", 0.5, -0.05),
        setting("gap", 1, "memory", 0.7, 0.0),
        setting("gap", 5, "camera", 0.6, -0.2),
        setting("gap", 5, "memory", 0.4, -0.3),
    ],
    "by_robot": {
        "camera": {"flat": EVERYBODY, "gap": {"crossed": [0.5, 0.5], "upright": [0.0, 1.0]}},
        "memory": {"flat": EVERYBODY, "gap": EVERYBODY | {"crossed": [0.7, 0.7]}},
    },
}
"""Numbers from which every table follows by hand."""


def test_tables_behind_the_ranking_by_hand():
    ground, severity, paired = leaderboard.result_tables([RESULT], None, None)
    assert ground[2] == [
        ("ours", "camera", "100.0 (100.0) [100.0 (100.0), 0.50]", "-", "-", "-", "-",
         "55.0 (55.0) [67.5 (67.5), 0.50]", "55.0 (55.0)", "70.0 (70.0)", 3),
        ("ours", "memory", "100.0 (100.0) [100.0 (100.0), 0.50]", "-", "-", "-", "-",
         "55.0 (55.0) [70.0 (70.0), 0.50]", "55.0 (55.0)", "70.0 (70.0)", 3),
    ]  # fmt: skip
    assert severity[1] == ("policy", "mode", "1", "5")
    assert severity[2] == [
        ("ours", "camera", "50.0 (75.0)", "60.0 (60.0)"),
        ("ours", "memory", "70.0 (85.0)", "40.0 (40.0)"),
    ]
    assert paired[2] == [
        ("flat", "+0.0 (+0.0 to +0.0)", "+0.0 (+0.0 to +0.0)"),
        ("gap", "+20.0 (+20.0 to +20.0)", "+50.0 (+0.0 to +100.0)"),
        ("all but the first", "+20.0 (+20.0 to +20.0)", "+50.0 (+0.0 to +100.0)"),
        ("all", "+13.3 (+13.3 to +13.3)", "+33.3 (+0.0 to +66.7)"),
    ]
    # Tables can be of one severity or onset.
    ground = next(leaderboard.result_tables([RESULT], 5, None))
    assert [row[-1] for row in ground[2]] == [1, 1]
    assert next(leaderboard.result_tables([RESULT], None, "before_the_edge"))[2] == []


def test_who_noticed_is_read_from_a_studys_rows(tmp_path, run_study):
    folder, _ = run_study("faults")
    noticed = leaderboard.study_table(folder / "summary.csv")
    assert noticed[1] == ("fault", "1", "5", "of each")
    # Two robots on flat ground, and on gaps two for each onset.
    rows = {fault: counts for fault, *counts in noticed[2]}
    assert (rows["frozen"], rows["gaussian"][1:]) == ([0, 0, 6], [6, 6])
    contents = {"other": b"kind\ngap\n", "half": b"mode\nrenet\n", "bytes": bytes(range(256))}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    for name in (*contents, "missing"):
        with pytest.raises(RenetError, match=r"is no summary|cannot read the summary"):
            leaderboard.study_table(tmp_path / name)
