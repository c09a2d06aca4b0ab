"""The model card: every number from the files, text that cannot break it, and refusals."""

import json
import re

import pytest
import yaml

from renet.bundle import DEFAULT, Bundle, pretrained, read_manifest
from renet.bundle.card import escape_markdown
from renet.cli import main

MANIFEST = (pretrained(DEFAULT) / "manifest.json").read_text()
ROW = {"mode": "camera", "fault": "gaussian", "robots": 23, "falls": 4}


def summary(**changes) -> dict:
    origin = {
        "bundle": DEFAULT,
        "bundle_hash": Bundle.load().sha256,
        "engine": "native",
        "seed": 987,
        "command": "renet evaluate faults",
        "date": "2031-05-17",
        "renet_version": "9.8.7",
    }
    return {
        "study": "noise",
        "runs": [ROW],
        "claims": [{"claim": "nobody falls | <b>ever</b>", "met": False, "measured": "4 fell"}],
        "missed": [{"fault": "foam", "severity": 3, "undetected": 17}],
        "provenance": origin | changes.pop("origin", {}),
    } | changes


@pytest.fixture
def results(tmp_path):
    def write(content):
        path = tmp_path / "results" / "noise" / "summary.json"
        path.parent.mkdir(parents=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path.parents[1]

    return write


def make(tmp_path, *arguments) -> tuple[dict, str]:
    """Front matter, as YAML has it, and Markdown of a card."""
    out = tmp_path / "card"
    assert main(["bundle", "card", "--out", str(out), *map(str, arguments)]) == 0
    start, front, text = (out / "README.md").read_text().split("---\n", 2)
    assert start == ""
    return yaml.safe_load(front), text


def test_front_matter_is_what_the_hub_reads(tmp_path, results):
    """Its specification asks of each result a task's type, a data set's type and name, metrics."""
    bare, _ = make(tmp_path)
    assert (bare["license"], bare["library_name"]) == ("apache-2.0", "renet")
    assert bare["pipeline_tag"] == "robotics"
    assert "onnx" in bare["tags"]
    assert bare["model-index"] == [{"name": DEFAULT, "results": []}]
    levels = {"levels": {"gap": 8.3, "flat": 10.0}, "levels_ci95": {"gap": [8.1, 8.5]}}
    front, _ = make(tmp_path, "--results", results(summary(runs=[ROW] * 41, **levels)))
    (model,) = front["model-index"]
    (result,) = model["results"]
    assert result["task"]["type"] == "robotics"
    assert result["dataset"] == {"type": "noise", "name": "renet evaluate faults"}
    assert [(metric["type"], metric["name"], metric["value"]) for metric in result["metrics"]] == [
        ("level", "mean highest level, gap (95 % interval 8.1 to 8.5)", 8.3),
        ("level", "mean highest level, flat", 10.0),
        ("falls", "falls of 943 robots with camera, in 41 of 41 settings", 164),
    ]


def test_every_number_comes_from_the_files(tmp_path, results):
    _, text = make(tmp_path, "--results", results(summary()))
    number = r"\d+(?:\.\d+)?(?:e-?\d+)?"
    # Numbers that are counted in the files, or said in words: "12 joints", "1 of 1", SHA-256.
    sources = [*re.findall(number, MANIFEST + json.dumps(summary())), 12, 1, 256]
    shown = [float(n) for n in re.findall(number, re.sub(r"[0-9a-f]{64}", "", text))]
    assert len(shown) > 30
    for value in shown:
        assert any(value == pytest.approx(float(source), rel=6e-3) for source in sources), value
    assert all(digest in text for digest in json.loads(MANIFEST)["sha256"].values())
    assert Bundle.load().sha256 in text
    assert "| noise | falls of 23 robots with camera, in 1 of 1 settings | 4 |" in text
    assert r"noise: not met: nobody falls \| &lt;b&gt;ever&lt;/b&gt; (4 fell)" in text
    assert "noise: 17 robots did not notice foam of severity 3" in text


def test_markup_is_escaped(tmp_path, results):
    hostile = "<script>alert(1)</script>\n# [x](javascript:y) | `z` {license}\u2028\ud800---\n"
    front, text = make(tmp_path, "--results", results(summary(study=hostile)))
    assert front["model-index"][0]["results"][0]["dataset"]["type"].startswith("<script>")
    assert "<script>" not in text
    assert "<b>" not in text
    assert "\n# [x]" not in text
    assert escape_markdown("a\n|b|") == r"a \|b\|"


def test_a_readme_that_is_no_card_stays(tmp_path, capsys):
    readme = tmp_path / "README.md"
    for text, code in (("# My thesis", 2), ("", 2), ("---\nlicense: mit\n---", 0)):
        readme.write_text(text)
        assert main(["bundle", "card", "--out", str(tmp_path)]) == code
        assert (readme.read_text() == text) == (code == 2)
    assert capsys.readouterr().err.count("README.md is no model card") == 2


def test_a_card_may_lie_in_its_bundle(tmp_path, bundle_path):
    assert main(["bundle", "card", str(bundle_path), "--out", str(bundle_path)]) == 0
    assert "never calibrated" in (bundle_path / "README.md").read_text()
    assert read_manifest(bundle_path) == Bundle.load(bundle_path).manifest


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "must hold a JSON object"),
        (summary(runs=[3]), "is no study's summary"),
        (summary(runs=None), "is no study's summary"),
        (summary(levels={"gap": "<b>"}), "could not convert string to float"),
        ({"study": "noise", "runs": []}, "lacks 'provenance'"),
        (summary(claims=[{}]), "lacks 'met'"),
        (summary(missed=[{}]), "lacks 'undetected'"),
        (summary(origin={"bundle_hash": "0" * 64}), "of another bundle"),
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
