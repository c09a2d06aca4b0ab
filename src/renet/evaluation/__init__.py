"""How good a bundle is: fault models, closed-loop rollouts, studies, figures and pages."""
