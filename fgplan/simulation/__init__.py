"""Closed loop: worlds to drive in, peers to drive against, and what is measured."""
