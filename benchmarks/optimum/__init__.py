"""How good a plan is: the energy chosen by `fgplan.plan` beside the best that is known."""
