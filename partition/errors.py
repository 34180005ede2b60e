"""What can go wrong in a partition."""

from __future__ import annotations


class PartitionError(ValueError):
    """No partition of the kind asked for exists, or the one given breaks an invariant."""
