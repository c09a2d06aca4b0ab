"""The model card: every number from the files, text that cannot break it, and refusals."""

import json
import re

import pytest

from renet.bundle import DEFAULT, Bundle, pretrained
from renet.cli import main
from renet.deploy.card import escape


def summary(**changes) -> dict:
    return {
        "study": "noise",
        "runs": [{"mode": "vp", "fault": "gaussian", "robots": 23, "falls": 4}],
        "claims": [{"claim": "nobody falls | <b>ever</b>", "met": False, "measured": "4 fell"}],
        "provenance": {
            "bundle": DEFAULT,
            "bundle_hash": Bundle.load().sha256,
            "engine": "native",
            "seed": 987,
            "command": "renet evaluate faults",
            "date": "2031-05-17",
            "renet_version": "9.8.7",
        },
    } | changes


@pytest.fixture
def results(tmp_path):
    def write(content):
        folder = tmp_path / "results" / "noise"
        folder.mkdir(parents=True, exist_ok=True)
        text = content if isinstance(content, str) else json.dumps(content)
        (folder / "summary.json").write_text(text)
        return folder.parent

    return write


def make(tmp_path, *arguments) -> str:
    out = tmp_path / "card"
    assert main(["bundle", "card", "--out", str(out), *map(str, arguments)]) == 0
    return (out / "README.md").read_text()


def test_front_matter_is_what_the_hub_reads(tmp_path):
    start, front, _ = make(tmp_path).split("---\n", 2)
    assert start == ""
    pairs = (line.split(": ", 1) for line in front.splitlines())
    found = {key: json.loads(value) for key, value in pairs}
    assert (found["license"], found["library_name"]) == ("apache-2.0", "renet")
    assert found["pipeline_tag"] == "robotics"
    assert "onnx" in found["tags"]


def test_every_number_comes_from_the_files(tmp_path, results):
    shipped = pretrained(DEFAULT)
    text = make(tmp_path, "--results", results(summary()))
    files = (shipped / "manifest.json").read_text() + json.dumps(summary())
    known = {float(n) for n in re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", files)}
    sizes = [path.stat().st_size for path in shipped.iterdir()]
    # Numbers that are counted in the files, or said in words: 95 %, "12 joints", "1 of 1".
    counted = {12.0, 95.0, 1.0}
    body = re.sub(r"[0-9a-f]{64}", "", text.split("---\n", 2)[2])
    shown = [float(n) for n in re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", body)]
    assert len(shown) > 30
    for number in shown:
        candidates = {*known, *sizes, *counted}
        assert any(number == pytest.approx(k, rel=6e-3) for k in candidates), number
    for digest in json.loads((shipped / "manifest.json").read_text())["sha256"].values():
        assert digest in text
    assert Bundle.load().sha256 in text
    assert "robots fell 4 times, in 1 of 1 settings" in text
    assert "not met" in text


def test_many_settings_are_summed_by_mode(tmp_path, results):
    row = summary()["runs"][0]
    text = make(tmp_path, "--results", results(summary(runs=[row] * 41)))
    assert "| vp | 41 | 943 | 164 |" in text


def test_markup_is_escaped(tmp_path, results):
    hostile = summary(study="<script>alert(1)</script>\n# [x](javascript:y) | `z`")
    text = make(tmp_path, "--results", results(hostile))
    assert "<script>" not in text
    assert "<b>" not in text
    assert "\n# [x]" not in text
    assert r"\| &lt;b&gt;ever" in text
    assert escape("a\n|b|") == r"a \|b\|"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "must hold a JSON object"),
        (summary(runs=[3]), "runs must be objects"),
        (summary(runs=None), "is no study's summary"),
        ({"study": "noise", "runs": []}, "lacks 'provenance'"),
        (summary(claims=[{}]), "lacks 'claim'"),
        (summary(missed=[{}]), "lacks 'fault'"),
        (
            summary(provenance=summary()["provenance"] | {"bundle_hash": "0" * 64}),
            "of another bundle",
        ),
    ],
)
def test_bad_results_are_one_line_and_nothing_is_written(
    tmp_path, results, capsys, content, message
):
    out = tmp_path / "card"
    where = ["--out", str(out), "--results", str(results(content))]
    assert main(["bundle", "card", *where]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["nowhere", "--out", "card"],
        ["--out", "file"],
        ["--out", "card", "--results", "nowhere"],
        ["--out", "card", "--license", "a b\nc"],
    ],
)
def test_bad_arguments_are_one_line(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    assert main(["bundle", "card", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (tmp_path / "file").read_text() == "kept"
    assert not (tmp_path / "card").exists()
