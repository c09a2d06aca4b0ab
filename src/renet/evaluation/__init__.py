"""Evaluation of bundles: closed-loop rollouts under camera faults, studies, figures and tables."""
