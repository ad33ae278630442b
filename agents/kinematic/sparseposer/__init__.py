"""SparsePoser."""
