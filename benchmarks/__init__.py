"""Speed and quality tables, run by hand: `python -m benchmarks.<name>`."""
