"""How fast a plan is: fgplan's solver beside its peers on the identical density, in one run."""
