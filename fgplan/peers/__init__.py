"""Planners that people use today, written as they are usually run, to compare with."""
