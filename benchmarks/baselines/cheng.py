"""Extreme Parkour (Cheng et al. 2023, arXiv 2309.14341) on RENet's robot and tiles.

A privileged teacher learns by reinforcement on scan dots, here the height map and the velocity.
A depth policy with a recurrent encoder then imitates it by DAgger: its actor begins as the
teacher's, drives from the first step, and learns by the Euclidean norm of the difference of
actions. benchmarks/NOTES.md says what differs.
"""

from baselines.distillation import STUDENT, TEACHER, Stage

STAGES = (
    Stage("teacher", 2 / 3, TEACHER),
    Stage(
        "student",
        1 / 3,
        STUDENT,
        teachers={"teacher": ()},
        distillation={"norm": 2, "starts_as_teacher": True},
    ),
)
