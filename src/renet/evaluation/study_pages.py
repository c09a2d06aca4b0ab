"""What the report says about the terrain, success, standing, course and filter studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from renet.evaluation.figures import MODE_NAMES
from renet.evaluation.page import Cell, Page
from renet.evaluation.standing import DRIFT, RESTLESS


def terrain_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The paper's table."""
    settings = summary["settings"]
    page.heading("Parkour: how far up the curriculum")
    page.text(
        f"{summary['robots']} robots on every level of every tile, {settings['speed']} m/s"
        " commanded in a random direction. A robot passes a level when it leaves the tile within"
        f" {settings['seconds']:g} s, starting again after a fall; its level is the number passed"
        " in a row, out of 10. The paper's robots reach 9.8 to 9.9."
    )
    levels, intervals = summary["levels"], summary["levels_ci95"]
    page.table(
        ["terrain", "mean highest level", "95 % interval"],
        [
            (name, f"{level:.2f}", "{:.2f} to {:.2f}".format(*intervals[name]))
            for name, level in levels.items()
        ],
    )
    page.facts(
        [
            (f"{summary['collisions']:.3f}", "colliding bodies per robot and step"),
            (f"{summary['lin_vel_reward']:.3f}", "linear velocity reward, of 1"),
            (str(summary["falls_on_flat"]), f"falls of {summary['robots']} robots on flat ground"),
        ]
    )
    page.picture(folder / "terrain.png", "Share of robots that pass each level.")


def success_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """Success rate against size."""
    settings = summary["settings"]
    trials = summary["runs"][0]["trials"]
    fault = f", cameras failing ({settings['fault']})" if settings["fault"] else ""
    page.heading("One try at each obstacle")
    page.text(
        f"{trials} robots for each size and mode walk straight at the obstacle{fault},"
        f" {settings['speed']} m/s commanded. A try counts when the robot is across within"
        f" {settings['seconds']:g} s without a fall. The bars are 95 % bootstrap intervals: where"
        " all tries ended alike they have no width, which does not mean certainty."
    )
    page.picture(folder / "success.png", "Share of robots that cross, against the size.")
    page.table(
        ["obstacle", "policy", "size (cm)", "crossed", "fell", "stuck", "95 % interval"],
        [_success_row(run) for run in summary["runs"]],
        text=2,
        folded=f"All {len(summary['runs'])} settings",
    )


def _success_row(run: dict[str, Any]) -> tuple[Any, ...]:
    low, high = 100 * run["success_ci95_low"], 100 * run["success_ci95_high"]
    tone = "good" if run["success_rate"] > 0.5 else "bad"
    return (
        run["kind"].replace("_", " "),
        MODE_NAMES[run["mode"]],
        f"{100 * run['size_m']:.0f}",
        Cell(f"{run['crossed']} of {run['trials']}", tone),
        run["falls"],
        run["stuck"],
        f"{low:.0f} to {high:.0f} %",
    )


def standing_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """Who stands when told to."""
    settings = summary["settings"]
    page.heading("Standing on command")
    page.text(
        f"Robots walk for {settings['walk']:g} s, are then commanded 0 m/s, and have"
        f" {settings['settle']:g} s to stop. One stands still that drifts less than"
        f" {100 * DRIFT:.0f} cm in the next {settings['stand']:g} s with joints slower than"
        f" {RESTLESS:g} rad/s on average. Falls count from the command on."
    )
    page.picture(folder / "standing.png", "How fast the joints move, before and after.")
    page.table(
        ["ground", "policy", "stand still", "fell", "drift (m)", "joints (rad/s)"],
        [
            (
                f"{run['kind'].replace('_', ' ')}, level {run['level']}",
                MODE_NAMES[run["mode"]],
                Cell(
                    f"{run['still']} of {run['robots']}",
                    "good" if run["still"] > 0.5 * run["robots"] else "bad",
                ),
                run["falls"],
                *(
                    "–" if run[name] is None else f"{run[name]:.2f}"
                    for name in ("drift_m", "joint_speed_rad_per_s")
                ),
            )
            for run in summary["runs"]
        ],
        text=2,
    )


def course_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The long walk."""
    settings, laps = summary["settings"], summary["laps"]
    page.heading("The course")
    page.text(
        f"Each robot walks {laps} lap{'s' if laps > 1 else ''} of {summary['lap_m']:.0f} m"
        f" unattended, obstacles of level {settings['level']} of 10, {settings['speed']} m/s"
        " commanded towards the middle of the way. In grass and under the occlusion the camera"
        " fails. A robot that falls, or spends more than"
        f" {settings['patience']:g} s on one passage, is counted and set down at the next one."
    )
    page.table(
        ["policy", "walked (km)", "passages crossed", "falls", "stuck", "falls per km"],
        [
            (
                MODE_NAMES[total["mode"]],
                f"{total['distance_m'] / 1000:.2f}",
                f"{total['crossed']} of {total['passages']}",
                Cell(str(total["falls"]), "bad" if total["falls"] else "good"),
                Cell(str(total["stuck"]), "bad" if total["stuck"] else "good"),
                "–" if total["falls_per_km"] is None else f"{total['falls_per_km']:.1f}",
            )
            for total in summary["totals"]
        ],
    )
    if (folder / "course.png").exists():
        page.picture(
            folder / "course.png",
            "One robot under RENet: reconstruction loss and threshold on the left axis, vision"
            " probability on the right. Green: VP in charge. Red: OP in charge.",
        )
    page.picture(folder / "passages.png", "How every passage went.")
    page.table(
        ["policy", "robot", "walked (m)", "minutes", "falls", "stuck", "switches"],
        [
            (
                MODE_NAMES[robot["mode"]],
                robot["robot"],
                f"{robot['distance_m']:.0f}",
                f"{robot['seconds'] / 60:.1f}",
                robot["falls"],
                robot["stuck"],
                robot["switches"],
            )
            for robot in summary["robots"]
        ],
        folded="Robot by robot",
    )


def filter_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The filter figure."""
    page.heading("The selector's filter")
    page.text(
        "A filter with weight γ that runs at a given rate delays the switch; a heavy one rides out"
        " a flickering camera (0.1 s of noise in every 0.4 s), a light one follows it."
    )
    page.picture(
        folder / "filter.png",
        "Delay against the formula (dotted: the paper's 0.04 s), and switches per minute.",
    )
    page.table(
        ["γ", "rate (Hz)", "delay (s)", "formula (s)", "switches per minute"],
        [
            (
                f"{run['gamma']:g}",
                f"{run['rate_hz']:g}",
                "not within the run" if run["delay_s"] is None else f"{run['delay_s']:.3f}",
                f"{run['formula_s']:.3f}",
                f"{run['switches_per_minute']:.0f}",
            )
            for run in summary["runs"]
        ],
        folded=f"All {len(summary['runs'])} filters",
    )


def pictures_section(page: Page, summary: dict[str, Any], folder: Path) -> None:
    """The ground as VP predicts it, and what the tiles and the camera look like."""
    settings = summary["settings"]
    page.heading("The ground as the robot believes it to be")
    page.text(
        "The VP estimator's height map beside the true one, where each robot had the most relief"
        f" around it; errors are over {settings['seconds']:g} s on tiles of level"
        f" {settings['level']}, and “flat” is the error of taking all ground for flat."
    )
    page.picture(folder / "height_map.png", "True ground, and predicted.")
    page.picture(folder / "tiles.png", "Every kind of tile at levels 1, 5 and 10.")
    page.picture(folder / "camera.png", "The camera's errors, one more in each row.")
