"""The page's selector decides and says what the runtime's does, whatever it is given."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.interface import DEPTH_SHAPE
from renet.page.contract import contract
from renet.page.writer import WEB
from renet.selector import make_selector
from renet.selector.monitors import SelectorInput
from tests.page.conftest import run_node

STEPS = 3000
PICTURES = 8
"""Number of images, of which the last four are odd (see `images`)."""
LIVE = PICTURES - 4
LIMITS = ("visionThreshold", "near", "covered", "patch", "frozenPatches", "steady", "agrees")
"""Entries of the contract that a selector needs, beside those of the camera."""
SEEN = "fresh age invalid velocityOp velocityVp hasImage"
SEEN += " anomalyScore varianceScore surprise mapError"
NAMES = {re.sub("([A-Z])", r"_\1", name).lower(): name for name in SEEN.split()}
"""What the page calls fields of `SelectorInput`, by their own names."""


def images(rng: np.random.Generator) -> np.ndarray:
    """Live ones, two whose lower half is the same, a blank one and a covered one."""
    pictures = rng.uniform(0.2, 0.9, (PICTURES, *DEPTH_SHAPE)).astype(np.float32)
    pictures[-3, 24:] = pictures[-4, 24:]
    pictures[-2] = 0.5
    pictures[-1, :30] = 0.01
    return pictures


def moods(rng: np.random.Generator, limits: dict[str, float]) -> list[dict[str, Any]]:
    """Steps of a camera that is well for a while, then late, frozen, spoilt or blank, and so on."""
    steps, now, mood, left, picture = [], 3.0, "well", 80, 0
    for step in range(STEPS):
        if left == 0:
            mood = str(
                rng.choice(
                    ["well", "well", "late", "frozen", "half", "spoilt", "blank", "apart", "lying"]
                )
            )
            left = int(rng.integers(5, 150))
        left -= 1
        now += float(rng.choice([0.0, 0.02, 0.02, 0.021, 0.05]))
        tick = step % 5 == 0
        if tick and mood != "frozen":
            odd = {"half": LIVE + step % 2, "blank": PICTURES - 2 + step % 2}
            picture = odd.get(mood, step % LIVE)
        fresh = bool(step == 0 or (tick and mood != "late"))
        bad = 3.0 if mood == "spoilt" else 0.3
        scores = {
            "anomalyScore": bad * limits.get("reconstruction", 0.01),
            "varianceScore": bad * limits.get("variance", 1.0) if rng.random() > 0.01 else None,
            "surprise": float(rng.uniform(0.0, 3.0)) if mood == "lying" else 0.3,
            "mapError": bad * limits.get("map_error", 1.0),
        }
        seen = {
            "fresh": fresh,
            "age": 0.5 if mood == "late" else 0.05,
            "invalid": 0.0,
            "velocityOp": [0.5, 0.0, 0.0],
            "velocityVp": [2.5 if mood == "apart" else 0.5, 0.0, 0.0],
            "hasImage": mood in ("well", "apart", "lying"),
        }
        steps.append({"now": now, "tick": tick, "picture": picture, "scores": scores, **seen})
    return steps


def decide(kind: str, spec, pictures: np.ndarray, steps: list[dict[str, Any]]) -> list[dict]:
    """What the runtime's selector makes of it."""
    selector, image, decided = make_selector(kind, spec), None, []
    for step in steps:
        if step["tick"] and step["fresh"]:
            image = pictures[step["picture"]][None].copy()
        scores = {k: np.inf if v is None else v for k, v in step["scores"].items()}
        fields = {snake: np.array([(step | scores)[name]]) for snake, name in NAMES.items()}
        seen = SelectorInput(image=image, **fields)
        verdict = None
        if step["tick"]:
            gate = selector.look(seen)
            verdict = bool(gate.judge(fields)[0])
        decision = {"gate": verdict, "vision": bool(selector.update(seen, step["now"])[0])}
        decision |= {name: str(getattr(selector, name)[0]) for name in ("state", "reason")}
        decided.append({**decision, "probability": float(selector.probability[0])})
    return decided


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("kind", "memory", "states"),
    [
        ("memory", 1.5, {"sees", "remembers", "blind"}),
        ("memory", 0.0, {"sees", "blind"}),
        ("switch", 0.0, {"sees", "blind"}),
    ],
)
def test_selector_decides_and_says_the_same(node_page, tmp_path: Path, kind, memory, states, seed):
    bundle, rng = Bundle.load(), np.random.default_rng(seed)
    spec = replace(bundle.manifest.selector, longest_memory=memory)
    changed = {"reconstruction": 0.02, "surprise": 1.5, "map_error": 0.1}
    spec = replace(spec, thresholds=spec.thresholds | changed)
    bundle = replace(bundle, manifest=replace(bundle.manifest, selector=spec))
    shared, pictures = contract([bundle]), images(rng)
    limits = {"reconstruction": spec.beta} if kind == "switch" else spec.thresholds
    steps = moods(rng, limits)
    given = {
        "spec": shared["bundles"][0]["selectors"][kind],
        "contract": {name: shared[name] for name in (*LIMITS, "camera")},
        "images": pictures.reshape(PICTURES, -1).tolist(),
        "steps": steps,
    }
    (tmp_path / "input.json").write_text(json.dumps(given))

    mine = run_node("selector.mjs", WEB, tmp_path / "input.json")

    its = decide(kind, spec, pictures, steps)
    assert {decision["state"] for decision in its} == states
    assert len({decision["reason"] for decision in its}) >= (4 if memory else 2)
    gates = {decision["gate"] for decision in its}
    assert gates == {True, None} | ({False} if memory else set())
    for step, (one, other) in enumerate(zip(mine, its, strict=True)):
        assert one.pop("probability") == pytest.approx(other.pop("probability"), abs=1e-9), step
        assert one == other, step
